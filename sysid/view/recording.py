"""Writes a Rerun recording (``.rrd``): moving machine, trails, signals, and their layout."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sysid.datasets.recording import Dataset, Recording
from sysid.files import written_whole
from sysid.gap.result import Map
from sysid.view.drawing import OTHERS, SHOWN, STYLES, TIMELINE, Style, log_machine, log_points, sdk, styles_of
from sysid.view.layout import blueprint
from sysid.view.maps import log_maps


def write_rerun(
    path: Path, dataset: Dataset, recording: str, predictions: Mapping[str, pd.DataFrame], maps: Sequence[Map] = ()
) -> Path:
    """Write one recording with its simulations.

    Args:
        path: the ``.rrd`` file; its folder is made if needed.
        recording: name of the recording in ``dataset``.
        predictions: name (``before``, ``after``) → ``time`` [s] and one column a signal (SI), as rollouts return them.
        maps: of a :class:`sysid.gap.GapResult`; the informative ones become bar charts.

    Returns:
        ``path``.

    Raises:
        StoreError: the dataset has no such recording.
    """
    source = dataset.recording(recording)
    tables = {"measured": source.table, **predictions}
    rr = sdk()
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as half:
        # Equal dataset versions and recordings have the same identity in the viewer.
        stream = rr.RecordingStream("sysid", recording_id=f"{dataset.reference}/{recording}/{dataset.digest[:16]}")
        stream.save(str(half), default_blueprint=blueprint(dataset, source, tables, TIMELINE, maps))
        stream.send_recording_name(f"{dataset.reference} {recording}")
        styles = dict(zip(tables, styles_of(tables), strict=True))
        kinematics = dataset.machine.kinematics()
        if kinematics is not None:
            rr.log("machine", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, recording=stream)
            for name, table in tables.items():
                log_machine(stream, f"machine/{name}", dataset.machine, kinematics, table, styles[name])
                log_points(stream, f"machine/{name}", dataset.machine, table, styles[name])
        _log_signals(stream, dataset, source, tables, styles)
        log_maps(stream, maps, {name: STYLES[name].colour for name in ("before", "after")}, SHOWN)
        stream.flush()
        stream.disconnect()
    return path


def _log_signals(
    stream: Any, dataset: Dataset, source: Recording, tables: Mapping[str, pd.DataFrame], styles: Mapping[str, Style]
) -> None:
    """Every signal as one curve per version, in display units; commands once."""
    rr = sdk()
    commands = dict(zip((s for s in source.signals if s.endswith(".command")), OTHERS * len(source.signals), strict=False))
    for signal in source.signals:
        factor, unit = SHOWN.get(dataset.units.get(signal, "1"), (1.0, dataset.units.get(signal, "")))
        for name, table in tables.items():
            if signal not in table.columns or (signal.endswith(".command") and name != "measured"):
                continue
            values = factor * table[signal].to_numpy(dtype=np.float64)
            known = np.isfinite(values)
            if not known.any():
                continue
            entity = f"signals/{signal}/{name}"
            label = signal.removesuffix(".command") if signal in commands else name
            label = f"{label} [{unit}]" if unit not in ("", "1") else label
            look = rr.SeriesLines(
                colors=[commands.get(signal, styles[name].colour)], names=[label], widths=[1.5 if name == "measured" else 2.2]
            )
            rr.log(entity, look, static=True, recording=stream)
            times = [rr.TimeColumn(TIMELINE, duration=table["time"].to_numpy(dtype=np.float64)[known])]
            rr.send_columns(entity, indexes=times, columns=rr.Scalars.columns(scalars=values[known]), recording=stream)
