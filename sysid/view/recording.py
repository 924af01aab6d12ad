"""Writes Rerun recordings (``.rrd``) of a recording with its simulations: moving machine, trails, signals, errors, findings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Dataset, Recording
from sysid.display import quantity, shown_unit, with_unit
from sysid.gap.disagreement import worst_row
from sysid.gap.result import GapResult
from sysid.reports.result_figures import effect_figures, error_table, unnamed_sentence
from sysid.reports.words import effect_title
from sysid.scratch import pieces
from sysid.signals import point_signals
from sysid.view.drawing import (
    OTHER_COLOURS,
    STYLES,
    TIMELINE,
    Style,
    log_curve,
    log_machine,
    log_points,
    rerun_file,
    sdk,
    send_piece,
    styles_of,
)
from sysid.view.layout import AFTER_S, BEFORE_S, ENTITY, MOMENTS, blueprint, log_maps
from sysid.view.thinning import bucket, posed, shown_rows

Array = npt.NDArray[np.float64]


def write_rerun(
    path: Path, dataset: Dataset, recording: str, predictions: Mapping[str, pd.DataFrame], gap: GapResult | None = None
) -> Path:
    """Write one recording with its simulations.

    Args:
        path: the ``.rrd`` file; its folder is made if needed.
        recording: name of the recording in ``dataset``.
        predictions: name (``before``, ``after``) → ``time`` [s] and one column a signal (SI), as rollouts return them.
        gap: adds the findings as text, and the informative error maps as line charts.

    Returns:
        ``path``.

    Raises:
        StoreError: the dataset has no such recording.
    """
    source = dataset.recording(recording)
    tables = {"measured": source.table, **predictions}
    # Equal dataset versions and recordings have the same identity in the viewer.
    identity = f"{dataset.reference}/{recording}/{dataset.digest[:16]}"
    maps = gap.maps if gap is not None else ()
    moments = worst_moments(tables)
    worst = largest_moment(moments, tables)
    layout = blueprint(dataset, source, tables, TIMELINE, maps, findings=gap is not None, moment=worst)
    with rerun_file(path, identity, layout, f"{dataset.reference} {recording}") as stream:
        styles = dict(zip(tables, styles_of(tables), strict=True))
        kinematics = dataset.machine.kinematics()
        if kinematics is not None:
            rr = sdk()
            rr.log("machine", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, recording=stream)
            for number, (name, table) in enumerate(tables.items()):
                poses = posed(table)
                log_machine(stream, f"machine/{name}", dataset.machine, kinematics, poses, styles[name])
                log_points(stream, f"machine/{name}", dataset.machine, poses, styles[name], number)
        curves = _Curves(stream, worst)
        _log_signals(curves, dataset, source, tables, styles)
        _log_errors(curves, dataset, tables, styles, moments)
        if gap is not None:
            log_findings(stream, findings_text(gap, dataset), moments, dataset.units)
        log_maps(stream, maps, {name: STYLES[name].colour for name in ("before", "after")})
    return path


@dataclass(frozen=True)
class WorstMoment:
    """The row with the largest error of a simulated signal: ``error`` (simulated − measured) [SI] at ``time`` [s]."""

    signal: str
    version: str
    time: float
    error: float


def worst_moments(tables: Mapping[str, pd.DataFrame]) -> list[WorstMoment]:
    """Of every signal of every simulation; ``tables`` holds ``measured`` and simulations with the same rows."""
    found = []
    measured = tables["measured"]
    for version, table in tables.items():
        if version == "measured" or len(table) != len(measured):
            continue
        for signal in table.columns:
            if signal == "time" or signal.endswith(".command") or signal not in measured:
                continue
            simulated, reference = table[signal].to_numpy(), measured[signal].to_numpy()
            worst: tuple[int, float] | None = None
            for first, last in pieces(len(measured)):
                own = worst_row(simulated[first:last], reference[first:last])
                if own is not None and (worst is None or abs(own[1]) > abs(worst[1])):
                    worst = first + own[0], own[1]
            if worst is not None:
                found.append(WorstMoment(signal, version, float(measured["time"].iloc[worst[0]]), worst[1]))
    return found


def largest_moment(moments: Sequence[WorstMoment], tables: Mapping[str, pd.DataFrame]) -> float | None:
    """Time of the largest error of the first simulation [s]: of the tool, else of the tip, else of the motion of the signal."""
    own = [moment for moment in moments if moment.version == (moments[0].version if moments else "")]
    points = [[m for m in own if m.signal in point_signals(point)] for point in ("tool", "ee")]
    measured = posed(tables["measured"])
    motion = {m.signal: max(float(measured[m.signal].std()), 1e-9) for m in own}
    chosen = next((group for group in points if group), own)
    scale = dict.fromkeys(motion, 1.0) if chosen is not own else motion
    return max(chosen, key=lambda m: abs(m.error) / scale[m.signal]).time if chosen else None


def findings_text(gap: GapResult, dataset: Dataset) -> str:
    """The result as Markdown: effects with their values, unnamed errors, the held-out error of every signal."""
    lines = [f"## {gap.headline}\n"]
    for effect in gap.effects:
        title = effect_title(effect.name, effect.target, dataset.machine)
        lines.append(
            f"- **{title}** on {effect.target}: {', '.join(figure.sentence for figure in effect_figures(effect, dataset))}"
        )
    lines += [f"- {unnamed_sentence(item, dataset.machine)}" for item in gap.unnamed]
    return "\n".join([*lines, "\n### Held-out error (RMSE)\n", error_table(gap.gap, dataset.units).markdown()])


def log_findings(stream: Any, text: str, moments: list[WorstMoment], units: Mapping[str, str]) -> None:
    """The text, valid at all times, and a line at each worst moment."""
    rr = sdk()
    rr.log(ENTITY, rr.TextDocument(text, media_type="text/markdown"), static=True, recording=stream)
    for moment in sorted(moments, key=lambda item: item.time):
        rr.set_time(TIMELINE, duration=moment.time, recording=stream)
        size = quantity(abs(moment.error), units.get(moment.signal, "1"))
        level = "WARN" if moment.version == "before" else "INFO"
        text = f"{moment.version}: largest error of {moment.signal}, {size}"
        rr.log(MOMENTS, rr.TextLog(text, level=level), recording=stream)
    rr.reset_time(recording=stream)


@dataclass(frozen=True)
class _Curves:
    """Curves of a recording, of a long one thinned but for the seconds that are played at first.

    Args:
        moment: time of the largest error [s].
    """

    stream: Any
    moment: float | None

    def log(
        self,
        entity: str,
        table: pd.DataFrame,
        signal: str,
        unit: str | None,
        colour: tuple[int, int, int],
        label: str,
        width: float | None = None,
        against: pd.DataFrame | None = None,
    ) -> None:
        """A signal of ``table``, less that of ``against``, in display units; the label says how much is shown, if not all."""
        time, values, (factor, _) = table["time"].to_numpy(np.float64), table[signal].to_numpy(np.float64), shown_unit(unit)
        other = against[signal].to_numpy(np.float64) if against is not None else None

        def piece(first: int, last: int) -> Array:
            return factor * (values[first:last] if other is None else values[first:last] - other[first:last])

        played = (0, 0)
        if self.moment is not None:
            ends = np.searchsorted(time, (self.moment - BEFORE_S, self.moment + AFTER_S))
            played = int(ends[0]), int(ends[1])
        rows, shown = shown_rows(len(time), piece, played)
        if len(rows):
            label += f" ({len(rows)} of {len(time)} samples)" if bucket(len(time)) > 1 else ""
            log_curve(self.stream, entity, time[rows], shown, colour, with_unit(label, unit), width)


def _log_errors(
    curves: _Curves,
    dataset: Dataset,
    tables: Mapping[str, pd.DataFrame],
    styles: Mapping[str, Style],
    moments: list[WorstMoment],
) -> None:
    """Error of every simulated signal over time, and a mark where it is largest."""
    rr = sdk()
    for moment in moments:
        unit, simulated = dataset.units.get(moment.signal), tables[moment.version]
        colour, place = styles[moment.version].colour, f"errors/{moment.signal}/{moment.version}"

        curves.log(place, simulated, moment.signal, unit, colour, moment.version, against=tables["measured"])
        look = rr.SeriesPoints(colors=[colour], markers=["circle"], marker_sizes=[7.0], names=[f"largest {moment.version}"])
        rr.log(f"{place}/largest", look, static=True, recording=curves.stream)
        largest = rr.Scalars.columns(scalars=np.array([shown_unit(unit)[0] * moment.error]))
        send_piece(curves.stream, f"{place}/largest", np.array([moment.time]), largest)


def _log_signals(
    curves: _Curves, dataset: Dataset, source: Recording, tables: Mapping[str, pd.DataFrame], styles: Mapping[str, Style]
) -> None:
    """Every signal as one curve per version, in display units; commands once."""
    commands = dict(
        zip((s for s in source.signals if s.endswith(".command")), OTHER_COLOURS * len(source.signals), strict=False)
    )
    for signal in source.signals:
        unit = dataset.units.get(signal)
        for name, table in tables.items():
            if signal not in table.columns or (signal.endswith(".command") and name != "measured"):
                continue

            label = signal.removesuffix(".command") if signal in commands else name
            colour = commands.get(signal, styles[name].colour)
            width = 1.5 if name == "measured" else 2.2
            curves.log(f"signals/{signal}/{name}", table, signal, unit, colour, label, width)
