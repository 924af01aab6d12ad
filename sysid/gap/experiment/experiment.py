"""Specification of one recording to make: commands, initial position, limits, and the information expected from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.config import Strict
from sysid.machine import Machine
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]
Limits = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class EffectAt(Strict):
    """An effect and its target."""

    name: str
    target: str


@dataclass(frozen=True)
class Purpose(Strict):
    """An open hypothesis that the recording resolves.

    Args:
        kind: ``tie`` (effects that are not identifiable), or ``excitation`` (an effect that is not excited so far).
        text: what is expected, in words.
        effects: those of the hypothesis.
        nats: expected log-likelihood ratio of the least separated pair, with the rejected model refitted.
        needed: nats from which the hypothesis counts as resolved.
    """

    kind: Literal["tie", "excitation"]
    text: str
    effects: tuple[EffectAt, ...]
    nats: float
    needed: float


@dataclass(frozen=True)
class Experiment:
    """One recording to make.

    Args:
        machine: name in ``machine.toml``.
        motion, about: name in :data:`sysid.gap.experiment.motions.MOTIONS`, and its description.
        axes: axes that move; the others are held by their commands.
        repeats: number of recordings needed for ``needed`` nats.
        start: signal → initial value [m, rad].
        limits: signal → (lowest, highest) value of a command or a measurement during the recording. The machine has to be
            stopped where a measurement leaves its limits.
        predicted: signal → (lowest, highest) value in the simulations.
        provenance: dataset and plant versions, seed, software.
        commands: ``time`` [s] on the grid k/rate_hz and ``<axis>.command`` of every axis. For a force axis,
            ``<axis>.joint`` is the path for a position controller, and its command is the force expected for that path.
    """

    name: str
    machine: str
    motion: str
    about: str
    axes: tuple[str, ...]
    rate_hz: float
    repeats: int
    start: Mapping[str, float]
    limits: Limits
    predicted: Limits
    purposes: tuple[Purpose, ...]
    provenance: Mapping[str, str | int]
    commands: pd.DataFrame = field(compare=False)

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return len(self.commands) / self.rate_hz

    @property
    def words(self) -> str:
        """One-line description."""
        again = f", {self.repeats} times" if self.repeats > 1 else ""
        return f"{self.about} ({self.seconds:.0f} s{again}): {' '.join(purpose.text for purpose in self.purposes)}"


def outside(table: pd.DataFrame, limits: Limits) -> list[str]:
    """Signals of ``table`` that leave their limits anywhere; NaN values are ignored."""
    left = []
    for signal, (low, high) in limits.items():
        if signal in table.columns:
            values = table[signal].to_numpy(dtype=np.float64)
            values = values[~np.isnan(values)]
            if len(values) and (values.min() < low or values.max() > high):
                left.append(signal)
    return left


def command_columns(machine: Machine) -> tuple[str, ...]:
    """Columns of the commands of an experiment, in order, without ``time``."""
    paths = [axis_signal(axis.name, "joint") for axis in machine.axes if axis.actuation == "force"]
    return (*(axis_signal(axis.name, "command") for axis in machine.axes), *paths)
