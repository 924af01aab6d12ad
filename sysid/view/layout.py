"""Layout of the viewer: the machine on the left, its signals in tabs on the right, the commands below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from sysid.datasets.recording import Dataset, Recording
from sysid.gap.result import Map
from sysid.signals import split_signal
from sysid.view.findings import ENTITY as FINDINGS
from sysid.view.findings import MOMENTS, map_views

#: Seconds of the past that the trails of boom tip and tool show.
TRAIL_S = 3.0


def blueprint(
    dataset: Dataset,
    recording: Recording,
    tables: Mapping[str, pd.DataFrame],
    timeline: str,
    maps: Sequence[Map] = (),
    findings: bool = False,
) -> Any:
    """Rerun blueprint for one recording and its simulations, with maps of the gap in separate tabs.

    Args:
        findings: the recording holds the findings as text, and a line at each worst moment.
    """
    import rerun.blueprint as rrb

    signals = [name for name in recording.signals if not name.endswith(".command") and recording.table[name].notna().any()]
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
    left: list[Any] = [rrb.TextDocumentView(origin=FINDINGS, name="findings")] if findings else []
    if dataset.machine.kinematics() is not None:
        points = [f"machine/{name}/{point}" for name in tables for point in ("ee", "tool")]
        left = [machine_view(points, timeline), *left]
    if not left:
        return screen(right, timeline)
    shares = [2, 1] if len(left) > 1 else None
    return screen(rrb.Horizontal(rrb.Vertical(*left, row_shares=shares), right, column_shares=[1.1, 1]), timeline)


def _views(signal: str, tables: Mapping[str, pd.DataFrame]) -> list[Any]:
    """A signal over time, and below it the error of its simulations."""
    import rerun.blueprint as rrb

    views = [rrb.TimeSeriesView(origin=f"signals/{signal}", name=signal)]
    if any(name != "measured" and signal in table for name, table in tables.items()):
        views.append(rrb.TimeSeriesView(origin=f"errors/{signal}", name=f"error of {signal}: simulated − measured"))
    return views


def screen(views: Any, timeline: str) -> Any:
    """A blueprint of ``views`` with all panels collapsed."""
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        views,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(timeline=timeline, state="collapsed"),
        auto_views=False,
    )


def machine_view(points: Sequence[str], timeline: str) -> Any:
    """The machine in space; ``points`` leave a trail of :data:`TRAIL_S`."""
    import rerun as rr
    import rerun.blueprint as rrb

    now = rr.TimeRangeBoundary.cursor_relative(seconds=0.0)
    then = rr.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S)
    trail = rrb.VisibleTimeRanges([rr.VisibleTimeRange(timeline, start=then, end=now)])
    return rrb.Spatial3DView(origin="machine", name="machine", overrides=dict.fromkeys(points, trail))


def _active(tables: Mapping[str, pd.DataFrame], signals: list[str], owners: list[str]) -> int:
    """The tab with the largest error of the first simulation, relative to the standard deviation of the signal."""
    simulated = next((table for name, table in tables.items() if name != "measured"), None)
    if simulated is None or not owners:
        return 0
    measured = tables["measured"]
    errors = {
        name: float((simulated[name] - measured[name]).abs().mean() / max(measured[name].std(), 1e-9))
        for name in signals
        if name in simulated and len(simulated) == len(measured)
    }
    return owners.index(split_signal(max(errors, key=lambda name: errors[name]))[0]) if errors else 0
