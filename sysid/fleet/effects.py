"""The effects that are compared over a fleet, and their values in every recording."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import Field

from sysid.config import Strict
from sysid.gap.result import NamedEffect
from sysid.machine import EffectKey

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, order=True)
class FleetEffect(Strict):
    """An effect that the workflow named on at least one machine.

    Args:
        parameters: names of its form: one friction for both directions, or one for each.
    """

    name: str
    target: str
    side: str | None
    parameters: tuple[str, ...]

    @property
    def key(self) -> EffectKey:
        """What two forms of one effect share."""
        return self.name, self.target, self.side

    @classmethod
    def of(cls, effect: NamedEffect) -> FleetEffect:
        """The effect of a gap result."""
        return cls(effect.name, effect.target, effect.side, tuple(effect.parameters))


def union(machines: Iterable[Sequence[FleetEffect]]) -> tuple[FleetEffect, ...]:
    """The effects of all machines, each in its form with the most parameters, in the order of their first appearance."""
    found: dict[EffectKey, FleetEffect] = {}
    for effects in machines:
        for effect in effects:
            known = found.get(effect.key)
            if known is None or len(effect.parameters) > len(known.parameters):
                found[effect.key] = effect
    return tuple(found.values())


@dataclass(frozen=True)
class ParameterHistory(Strict):
    """Values of one parameter on one machine, one for each recording that determines it, in the order of time.

    Args:
        machine: name of the dataset.
        parameter: with ``[i]`` for a component of a vector; ``unit``: its SI unit.
        negligible: change of the parameter that has no practical significance.
        recordings: names; ``ends``: hours of recorded motion of this machine up to the end of each, (r,).
        values: (r,); ``deviations``: their standard deviations, (r,).
    """

    machine: str
    effect: FleetEffect
    parameter: str
    unit: str
    negligible: float
    recordings: tuple[str, ...]
    ends: tuple[float, ...]
    values: tuple[float, ...]
    deviations: tuple[Annotated[float, Field(gt=0.0)], ...]
