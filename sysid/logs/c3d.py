"""C3D trials of any motion capture system: every point is a stream ``x y z`` [m], all analog channels are one (``analog``).

Labels of markers are the names of the streams (``tip_body:Marker1``). A point that is not visible is missing, and so is one
exactly in the origin, which some programs write for points that are not visible. Events are not read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sysid.logs.c3d_file import C3dFile, read_c3d
from sysid.logs.capture import length_factor, without_lost
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import to_ns

#: Model outputs are stored like points; the file lists them under these names, with a unit of their own.
_MODEL_OUTPUTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
ANALOG = "analog"


@dataclass(frozen=True)
class C3dReader:
    """``capture`` stamps: the number of the frame over the rate, so that a cropped trial does not start at zero."""

    name: str = "c3d"
    suffixes: tuple[str, ...] = (".c3d",)
    clocks: tuple[str, ...] = ("capture",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        trial = read_c3d(path, options.budget_of(path, "a C3D file"))
        outputs = _model_outputs(trial)
        names = _names(trial.texts("POINT:LABELS"), trial.points.shape[1], "point")
        options.check_streams(path, [*names, ANALOG] if trial.analog.size else names, "point")
        stated = next((unit for unit in trial.texts("POINT:UNITS") if unit), "")
        markers = any(name not in outputs for name in names)
        factor = length_factor(path, stated, options) if markers else 1.0
        losses = _losses(path, trial)
        frames = np.arange(len(trial.points)) + trial.first
        stamps = {"capture": to_ns(frames / trial.rate, 1.0, str(path))}
        streams = []
        for index, name in enumerate(names):
            if not options.wants(name):
                continue
            unit = outputs.get(name, "m")
            values = trial.points[:, index] * (factor if name not in outputs else 1.0)
            columns = {axis: values[:, i] for i, axis in enumerate("xyz")}
            units = dict.fromkeys(columns, unit) if unit else {}
            kind = "Model Output" if name in outputs else "Marker"
            streams.append(Stream(name, path, stamps, columns, units, losses, kind=kind))
        if trial.analog.size and options.wants(ANALOG):
            streams.append(_analog(path, trial, losses))
        return without_lost(path, streams)


def _analog(path: Path, trial: C3dFile, losses: tuple[str, ...]) -> Stream:
    count, channels = trial.analog.shape
    each = count // len(trial.points)
    samples = np.arange(count) + trial.first * each
    names = _names(trial.texts("ANALOG:LABELS"), channels, "channel")
    stated = trial.texts("ANALOG:UNITS")
    units = {name: unit for name, unit in zip(names, stated, strict=False) if unit}
    columns = {name: trial.analog[:, i] for i, name in enumerate(names)}
    stamps = {"capture": to_ns(samples / (trial.rate * each), 1.0, str(path))}
    return Stream(ANALOG, path, stamps, columns, units, losses, kind="Analog")


def _names(labels: Sequence[str], count: int, what: str) -> list[str]:
    """A unique name for each of ``count`` columns."""
    names: dict[str, None] = {}
    for index in range(count):
        name = labels[index] if index < len(labels) and labels[index] else f"{what} {index + 1}"
        while name in names:
            name += f"#{index + 1}"
        names[name] = None
    return list(names)


def _model_outputs(trial: C3dFile) -> dict[str, str]:
    """Label → unit (as stated, may be empty) of the model outputs among the points."""
    found: dict[str, str] = {}
    for kind in _MODEL_OUTPUTS:
        unit = "".join(trial.texts(f"POINT:{kind[:-1]}_UNITS")[:1])
        found |= dict.fromkeys(trial.texts(f"POINT:{kind}"), unit)
    return found


def _losses(path: Path, trial: C3dFile) -> tuple[str, ...]:
    losses = [f"{path.name}: {note}" for note in trial.notes]
    frames = len(trial.points)
    if frames < trial.stated:
        losses.append(f"{path.name}: the file is cut off: {frames} of {trial.stated} frames are there")
    rotations = trial.parameters.get("ROTATION:USED")
    if isinstance(rotations, np.ndarray) and rotations.any():
        losses.append(f"{path.name}: rotation matrices (ROTATION) are not read")
    return tuple(losses)
