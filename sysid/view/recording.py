"""Writes a Rerun recording (``.rrd``): moving machine, trails, signals, and their layout."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sysid.datasets.recording import Dataset, Recording
from sysid.gap.result import GapResult
from sysid.view.drawing import (
    DISPLAY_UNITS,
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
)  # fmt: skip
from sysid.view.layout import WorstMoment, blueprint, findings_text, log_findings, log_maps, worst_moments


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
    layout = blueprint(dataset, source, tables, TIMELINE, maps, findings=gap is not None)
    with rerun_file(path, identity, layout, f"{dataset.reference} {recording}") as stream:
        styles = dict(zip(tables, styles_of(tables), strict=True))
        kinematics = dataset.machine.kinematics()
        if kinematics is not None:
            rr = sdk()
            rr.log("machine", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, recording=stream)
            for name, table in tables.items():
                log_machine(stream, f"machine/{name}", dataset.machine, kinematics, table, styles[name])
                log_points(stream, f"machine/{name}", dataset.machine, table, styles[name])
        _log_signals(stream, dataset, source, tables, styles)
        _log_errors(stream, dataset, tables, styles, moments)
        if gap is not None:
            log_findings(stream, findings_text(gap, dataset.machine, dataset.units), moments, dataset.units)
        log_maps(stream, maps, {name: STYLES[name].colour for name in ("before", "after")}, DISPLAY_UNITS)
    return path


def _log_errors(
    stream: Any, dataset: Dataset, tables: Mapping[str, pd.DataFrame], styles: Mapping[str, Style], moments: list[WorstMoment]
) -> None:
    """Error of every simulated signal over time, and a mark where it is largest."""
    rr = sdk()
    measured = tables["measured"]
    for moment in moments:
        factor, unit = DISPLAY_UNITS.get(dataset.units.get(moment.signal, "1"), (1.0, dataset.units.get(moment.signal, "")))
        error = factor * (tables[moment.version][moment.signal] - measured[moment.signal]).to_numpy(dtype=np.float64)
        known, time = np.isfinite(error), measured["time"].to_numpy(dtype=np.float64)
        colour, place = styles[moment.version].colour, f"errors/{moment.signal}/{moment.version}"
        log_curve(stream, place, time[known], error[known], colour, f"{moment.version} [{unit}]")
        look = rr.SeriesPoints(colors=[colour], markers=["circle"], marker_sizes=[7.0], names=[f"largest {moment.version}"])
        rr.log(f"{place}/largest", look, static=True, recording=stream)
        largest = rr.Scalars.columns(scalars=np.array([factor * moment.error]))
        send_piece(stream, f"{place}/largest", np.array([moment.time]), largest)


def _log_signals(
    stream: Any, dataset: Dataset, source: Recording, tables: Mapping[str, pd.DataFrame], styles: Mapping[str, Style]
) -> None:
    """Every signal as one curve per version, in display units; commands once."""
    commands = dict(
        zip((s for s in source.signals if s.endswith(".command")), OTHER_COLOURS * len(source.signals), strict=False)
    )
    for signal in source.signals:
        factor, unit = DISPLAY_UNITS.get(dataset.units.get(signal, "1"), (1.0, dataset.units.get(signal, "")))
        for name, table in tables.items():
            if signal not in table.columns or (signal.endswith(".command") and name != "measured"):
                continue
            values = factor * table[signal].to_numpy(dtype=np.float64)
            known = np.isfinite(values)
            if not known.any():
                continue
            label = signal.removesuffix(".command") if signal in commands else name
            label = f"{label} [{unit}]" if unit not in ("", "1") else label
            colour = commands.get(signal, styles[name].colour)
            time, width = table["time"].to_numpy(dtype=np.float64)[known], 1.5 if name == "measured" else 2.2
            log_curve(stream, f"signals/{signal}/{name}", time, values[known], colour, label, width)
