"""The Rerun recording of a machine's rounds: before and after on the same helix, errors of the tool, findings as text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from loop.flight import Flight
from loop.rounds import Round
from sysid.machine import Machine
from sysid.signals import axis_signal, point_signals
from sysid_rl.train.rerun_tracks import write_tracks

Array = npt.NDArray[np.float64]


def write_story(path: Path, machine: Machine, rounds: Sequence[Round], title: str) -> Path:
    """Write the helix of the first and of the last round side by side.

    Args:
        machine: as its owner describes it.
    """
    first, last = rounds[0].flights["helix"], rounds[-1].flights["helix"]
    length = min(len(first.time), len(last.time))
    target = first.target[:length]
    rows = {"before": _table(machine, first, length), "after": _table(machine, last, length)}
    return write_tracks(
        path, machine, target, rows, title, point="tool", texts=_texts(rounds, float(rows["before"]["time"].iloc[-1]))
    )


def _table(machine: Machine, flight: Flight, length: int) -> pd.DataFrame:
    columns: dict[str, Array] = {"time": flight.time[:length] - flight.time[0]}
    columns |= {axis_signal(name, "joint"): flight.joints[:length, i] for i, name in enumerate(machine.axis_names)}
    for point, values in (("ee", flight.tip), ("tool", flight.tool)):
        columns |= dict(zip(point_signals(point), values[:length].T, strict=True))
    return pd.DataFrame(columns)


def _texts(rounds: Sequence[Round], seconds: float) -> list[tuple[float, str]]:
    """Errors and findings of the rounds, spread over the recording."""
    lines = []
    for number, each in enumerate(rounds):
        worst = " / ".join(f"{value:.0f}" for value in each.flights["helix"].figures()["max_mm"])
        lines.append(f"round {number}: plant {each.plant}, largest error of the tool on the helix {worst} mm (x / y / z)")
        for effect in each.gap.effects if each.gap is not None else ():
            values = ", ".join(f"{key} {np.round(value, 4)}" for key, value in effect.given.items())
            lines.append(f"round {number}: named {effect.name} on {effect.target}: {values}")
    return [(seconds * k / max(1, len(lines)), line) for k, line in enumerate(lines)]
