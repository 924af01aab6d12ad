"""Layout of the viewer: the machine on the left, its signals in tabs on the right, the commands below, the findings beside it;
and maps of the gap as line charts: the mean error over a variable, before and after the repair, with ticks, units and words.

The viewer has no chart over another axis than time, so that curves, axes and labels are drawn as lines and points in a plane.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.chunked import measured
from sysid.datasets.recording import Dataset, Recording
from sysid.display import shown_unit, with_unit
from sysid.gap.result import Map
from sysid.machine import Machine
from sysid.pictures import ticks
from sysid.signals import axis_signal, point_signals, split_signal
from sysid.view.thinning import posed

Array = npt.NDArray[np.float64]

#: Entities of the findings as text, and of the worst moments.
ENTITY, MOMENTS = "findings", "moments"

#: Largest number of maps per output, and the least share of the variance that they explain.
MAX_MAPS, MIN_EXPLAINED = 3, 0.15
#: Size of a chart in its plane, and its margin for labels.
WIDTH, HEIGHT, MARGIN = 520.0, 130.0, 30.0
GREY, FAINT, BAND = (130, 138, 146), (90, 96, 102), (70, 76, 82)


def informative(maps: Sequence[Map]) -> list[Map]:
    """The maps of each output that explain most of its gap, in the order of the outputs."""
    found = []
    for signal in dict.fromkeys(item.signal for item in maps):
        of_signal = sorted((item for item in maps if item.signal == signal), key=lambda item: -item.explains)
        found += [item for item in of_signal if item.explains > MIN_EXPLAINED][:MAX_MAPS]
    return found


def entity(item: Map) -> str:
    """Entity path of a map."""
    return "/".join(("maps", item.signal, item.quantity.replace(" ", "_"), item.over.replace(" ", "_")))


def log_maps(stream: Any, maps: Sequence[Map], colours: Mapping[str, tuple[int, int, int]]) -> None:
    """Log the informative maps, valid at all times; ``colours``: of ``before`` and ``after``."""
    for item in informative(maps):
        factor, across = shown_unit(item.error_unit)[0], shown_unit(item.unit)[0]
        curves = {"before": factor * np.array(item.mean), "after": factor * np.array(item.after)}
        curves = {name: values for name, values in curves.items() if len(values)}
        words = with_unit(item.over, item.unit), with_unit(f"{item.quantity} of {item.signal}", item.error_unit)
        _log_chart(stream, entity(item), across * np.array(item.at), curves, 2.0 * factor * item.noise_floor, words, colours)


def map_views(maps: Sequence[Map]) -> list[Any]:
    """One tab for each output with informative maps."""
    import rerun.blueprint as rrb

    shown = informative(maps)
    bounds = rrb.VisualBounds2D(x_range=[-MARGIN, WIDTH + 2.0 * MARGIN], y_range=[-MARGIN, HEIGHT + 2.2 * MARGIN])
    return [
        rrb.Vertical(
            *(
                rrb.Spatial2DView(origin=entity(item), name=f"{item.quantity} over {item.over}", visual_bounds=bounds)
                for item in shown
                if item.signal == signal
            ),
            name=f"map {signal}",
        )
        for signal in dict.fromkeys(item.signal for item in shown)
    ]


def _log_chart(
    stream: Any,
    path: str,
    x: Array,
    curves: Mapping[str, Array],
    noise: float,
    words: tuple[str, str],
    colours: Mapping[str, tuple[int, int, int]],
) -> None:
    import rerun as rr

    values = np.concatenate([*curves.values(), np.array([-noise, noise])])
    ends = [(float(np.nanmin(own)), float(np.nanmax(own))) for own in (x, values)]
    (left, right), (low, high) = [(a, b) if b > a else (a - 0.5, a + 0.5) for a, b in ends]

    def place(a: Array, b: Array) -> Array:
        return np.column_stack([WIDTH * (a - left) / (right - left), HEIGHT * (high - b) / (high - low)])

    def log(name: str, value: Any) -> None:
        rr.log(f"{path}/{name}", value, static=True, recording=stream)

    edges = np.array([left, right])
    frame = [place(np.array([left, left, right]), np.array([high, low, low])), place(edges, np.zeros(2))]
    log("axes", rr.LineStrips2D(frame[: 2 if low < 0.0 < high else 1], colors=[GREY, FAINT], radii=0.4))
    if noise > 0.0:
        log("noise", rr.LineStrips2D([place(edges, np.full(2, side)) for side in (-noise, noise)], colors=[BAND], radii=0.3))
    across, up = ticks(left, right), ticks(low, high)
    at = [*place(np.array(across), np.full(len(across), low)), *place(np.full(len(up), left), np.array(up))]
    texts = [f"{value:.4g}" for value in (*across, *up)]
    log("ticks", rr.Points2D(at, labels=texts, colors=[GREY], radii=1.0, show_labels=True))
    titles = np.array([[WIDTH / 2.0, HEIGHT + MARGIN], [WIDTH / 2.0, -MARGIN / 2.0]])
    log("words", rr.Points2D(titles, labels=list(words), colors=[GREY], radii=0.1, show_labels=True))
    for name, own in curves.items():
        known = np.isfinite(own) & np.isfinite(x)
        points = place(x[known], own[known])
        log(name, rr.LineStrips2D([points], colors=[colours[name]], radii=0.8))
        log(f"{name}/bins", rr.Points2D(points, colors=[colours[name]], radii=1.6))
        end = points[-1:] + np.array([[MARGIN, 0.0]]) if len(points) else points
        log(f"{name}/name", rr.Points2D(end, labels=[name], colors=[colours[name]], radii=0.1, show_labels=True))


#: Seconds of the past that the trails of boom tip and tool show.
TRAIL_S = 3.0


def blueprint(
    dataset: Dataset,
    recording: Recording,
    tables: Mapping[str, pd.DataFrame],
    timeline: str,
    maps: Sequence[Map] = (),
    findings: bool = False,
    moment: float | None = None,
) -> Any:
    """Rerun blueprint for one recording and its simulations, with maps of the gap in separate tabs.

    Args:
        findings: the recording holds the findings as text, and a line at each worst moment.
        moment: time of the largest error [s], which is played at first; None without one.
    """
    import rerun.blueprint as rrb

    signals = [name for name in recording.signals if not name.endswith(".command") and measured(recording.values(name))]
    owners = list(dict.fromkeys(split_signal(name)[0] for name in signals))
    tabs = [
        rrb.Vertical(
            *(view for name in signals if split_signal(name)[0] == owner for view in _views(name, tables)),
            name=owner,
        )
        for owner in owners
    ]
    commands = [f"+ signals/{name}/**" for name in recording.signals if name.endswith(".command")]
    below: list[Any] = [rrb.TimeSeriesView(origin="signals", contents=commands, name="commands")]
    if findings:
        below.append(rrb.TextLogView(origin=MOMENTS, name="worst moments"))
    above = [*tabs, *map_views(maps)]  # none where the recording has no measured value
    right: Any = rrb.Tabs(*below)
    if above:
        right = rrb.Vertical(rrb.Tabs(*above, active_tab=_active(tables, signals, owners)), right, row_shares=[3, 1])
    left: list[Any] = [rrb.TextDocumentView(origin=ENTITY, name="findings")] if findings else []
    if dataset.machine.kinematics() is not None:
        points = [f"machine/{name}/{point}" for name in tables for point in ("ee", "tool")]
        left = [machine_view(points, timeline, camera(dataset.machine, tables["measured"])), *left]
    if not left:
        return screen(right, timeline, moment)
    shares = [2, 1] if len(left) > 1 else None
    views = rrb.Horizontal(rrb.Vertical(*left, row_shares=shares), right, column_shares=[1.1, 1])
    return screen(views, timeline, moment)


def _views(signal: str, tables: Mapping[str, pd.DataFrame]) -> list[Any]:
    """A signal over time, and below it the error of its simulations."""
    import rerun.blueprint as rrb

    views = [rrb.TimeSeriesView(origin=f"signals/{signal}", name=signal)]
    if any(name != "measured" and signal in table for name, table in tables.items()):
        views.append(rrb.TimeSeriesView(origin=f"errors/{signal}", name=f"error of {signal}: simulated − measured"))
    return views


#: Time around the largest error that is played at first [s].
BEFORE_S, AFTER_S = 4.0, 1.0


def screen(views: Any, timeline: str, moment: float | None = None) -> Any:
    """A blueprint of ``views`` with all panels collapsed, which plays the seconds around ``moment`` [s]."""
    import rerun.blueprint as rrb
    from rerun.blueprint.components import AbsoluteTimeRange

    panel = rrb.TimePanel(timeline=timeline, state="collapsed")
    if moment is not None:
        ends = (int(1e9 * max(0.0, moment - BEFORE_S)), int(1e9 * (moment + AFTER_S)))
        panel.time_selection = AbsoluteTimeRange(*ends)
        panel.loop_mode, panel.play_state = "selection", "playing"
    return rrb.Blueprint(
        views, rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed"), panel, auto_views=False
    )


def machine_view(points: Sequence[str], timeline: str, eye: Any = None) -> Any:
    """The machine in space; ``points`` leave a trail of :data:`TRAIL_S`, ``eye`` is from :func:`camera`."""
    import rerun as rr
    import rerun.blueprint as rrb

    now = rr.TimeRangeBoundary.cursor_relative(seconds=0.0)
    then = rr.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S)
    trail = rrb.VisibleTimeRanges([rr.VisibleTimeRange(timeline, start=then, end=now)])
    return rrb.Spatial3DView(origin="machine", name="machine", overrides=dict.fromkeys(points, trail), eye_controls=eye)


#: Share of the rows that the camera leaves out at either end of each coordinate, and its height over the arm.
OUTSIDE, ELEVATION = 0.02, 0.35


def camera(machine: Machine, table: pd.DataFrame) -> Any:
    """An eye across the middle direction of the arm, at a distance that shows joints, tip and tool of a recording.

    None where neither all joints nor the tip are known.
    """
    import rerun.blueprint as rrb

    points = arm_points(machine, table)
    if not len(points):
        return None
    low, high = (np.quantile(points, share, axis=0) for share in (OUTSIDE, 1.0 - OUTSIDE))
    target, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    outward = target[:2] / max(float(np.hypot(*target[:2])), 1e-9)
    aside = np.array([outward[1], -outward[0], ELEVATION]) if outward.any() else np.array([1.0, -1.0, ELEVATION])
    position = target + 2.2 * max(radius, 0.1) * aside / float(np.linalg.norm(aside))
    return rrb.EyeControls3D(kind="Orbital", position=position, look_target=target, eye_up=[0.0, 0.0, 1.0])


def arm_points(machine: Machine, table: pd.DataFrame) -> Array:
    """Origins of the links that the axes move, tip and tool in some rows of a recording, (n, 3) [m]."""
    kinematics, found = machine.kinematics(), list[Array]()
    rows = table.iloc[:: max(1, len(table) // 200)]
    joints = [axis_signal(axis.name, "joint") for axis in machine.axes]
    if kinematics is not None and set(joints) <= set(rows.columns):
        poses = kinematics.link_poses(rows[joints].to_numpy(dtype=np.float64))
        found += [poses[joint.child][:, :3, 3] for joint in kinematics.chain]
    for point in ("ee", "tool"):
        if set(point_signals(point)) <= set(rows.columns):
            found.append(rows[list(point_signals(point))].to_numpy(dtype=np.float64))
    points = np.concatenate([np.zeros((0, 3)), *found])
    return np.asarray(points[np.isfinite(points).all(axis=1)])


def _active(tables: Mapping[str, pd.DataFrame], signals: list[str], owners: list[str]) -> int:
    """The tab with the largest error of the first simulation, relative to the standard deviation of the signal."""
    simulated = next((table for name, table in tables.items() if name != "measured"), None)
    if simulated is None or not owners:
        return 0
    whole = len(simulated) == len(tables["measured"])
    true, simulated = posed(tables["measured"]), posed(simulated)
    errors = {
        name: float((simulated[name] - true[name]).abs().mean() / max(true[name].std(), 1e-9))
        for name in signals
        if name in simulated and whole
    }
    return owners.index(split_signal(max(errors, key=lambda name: errors[name]))[0]) if errors else 0
