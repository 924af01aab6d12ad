"""A recording that somebody should make: commands, where to start, what must not be left, and what it is expected to show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.config import STRICT
from sysid.machine import Machine
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]
Limits = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class EffectAt:
    """An effect and where it sits."""

    __pydantic_config__ = STRICT

    name: str
    target: str


@dataclass(frozen=True)
class Purpose:
    """A question that the recording answers.

    Args:
        kind: effects that tie, or one that the recordings so far could not have shown.
        text: what is expected, in words.
        effects: those in question.
        nats: expected log likelihood ratio between the least separated pair, natural log, after the loser has been refitted.
        needed: from how many nats on the question counts as answered.
    """

    __pydantic_config__ = STRICT

    kind: Literal["tie", "excitation"]
    text: str
    effects: tuple[EffectAt, ...]
    nats: float
    needed: float

    @property
    def resolves(self) -> bool:
        """Whether one such recording is expected to answer the question."""
        return self.nats >= self.needed


@dataclass(frozen=True)
class Experiment:
    """One recording to make.

    Args:
        machine: name in ``machine.toml``.
        motion, about: which motion of :data:`sysid.gap.experiment.motions.MOTIONS`, and what it is in words.
        axes: those that move; the others are held by their commands.
        repeats: how often the recording has to be made for ``needed`` nats.
        start: signal → value [m, rad] that the machine stands at when the commands begin.
        limits: signal → (lowest, highest) that a command may have, and that a measurement may have while it runs. Whoever
            executes it stops the machine where one is left.
        predicted: signal → (lowest, highest) that the simulations reached.
        provenance: dataset and plant versions, seed, software.
        commands: ``time`` [s] on the grid k/rate_hz and ``<axis>.command`` of every axis. A force axis has the path
            ``<axis>.joint`` that a position controller has to follow; its command is the force that this is expected to take.
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
        """How long it takes."""
        return len(self.commands) / self.rate_hz

    @property
    def words(self) -> str:
        """One line for people."""
        again = f", {self.repeats} times" if self.repeats > 1 else ""
        return f"{self.about} ({self.seconds:.0f} s{again}): {' '.join(purpose.text for purpose in self.purposes)}"


def outside(table: pd.DataFrame, limits: Limits) -> list[str]:
    """Signals of ``table`` that leave their limits anywhere; what is not measured (NaN) leaves nothing."""
    left = []
    for signal, (low, high) in limits.items():
        if signal in table.columns:
            values = table[signal].to_numpy(dtype=np.float64)
            values = values[~np.isnan(values)]
            if len(values) and (values.min() < low or values.max() > high):
                left.append(signal)
    return left


def command_columns(machine: Machine) -> tuple[str, ...]:
    """Columns that the commands of an experiment have, in order, without ``time``."""
    paths = [axis_signal(axis.name, "joint") for axis in machine.axes if axis.actuation == "force"]
    return (*(axis_signal(axis.name, "command") for axis in machine.axes), *paths)
