"""What an effect is: a name from the contract, its parameters, what shows it, and the slots it occupies in a compiled plant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Stage = Literal["command", "force", "joint", "end_effector", "tool", "sensor"]
TargetKind = Literal["axis", "machine", "base", "tool", "signal", "stream"]
Actuation = Literal["velocity", "position", "force"]


@dataclass(frozen=True)
class Slot:
    """One number that the compiled chain reads; at ``neutral`` the effect is absent."""

    name: str
    neutral: float = 0.0


@dataclass(frozen=True)
class Parameter:
    """One public parameter of an effect.

    Args:
        name: as in the contract.
        unit: SI; ``drive`` or ``signal`` stands for m or rad, whichever the target moves in or reads.
        bounds: what a fit may search, (low, high).
        starts: values from which a fit starts.
        negligible: a small departure from the neutral (or nominal) value, from which steps and tolerances of fits derive.
        scale: ``starts`` and ``negligible`` are multiples of the typical force, or of one over the typical gravity load, that
            the data show; "" where they are the values themselves.
        stepwise: a small change may change nothing at all (a threshold between two samples of a command): a fit searches it.
        secondary: it says how the effect acts, not how much: it means nothing without the others.
        sets: for each component of the parameter, the slots that take its value; by default the slot of the same name.
    """

    name: str
    unit: str
    bounds: tuple[float, float]
    starts: tuple[float, ...]
    negligible: float
    about: str
    sets: tuple[tuple[str, ...], ...] = ()
    stepwise: bool = False
    secondary: bool = False
    scale: Literal["", "force", "1/load"] = ""

    @property
    def components(self) -> tuple[tuple[str, ...], ...]:
        return self.sets or ((self.name,),)


@dataclass(frozen=True)
class Form:
    """A way to write the effect: one set of public parameters. The first form of an effect is its simplest."""

    parameters: tuple[Parameter, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.parameters)


@dataclass(frozen=True)
class Need:
    """What recordings must contain before the effect can be seen.

    Args:
        count: which quantity of :mod:`sysid.gap.excitation` is counted.
        least: how much of it, in its unit.
        advice: what to record where it is missing; ``{axis}`` stands for the target.
    """

    count: str
    least: float
    advice: str


@dataclass(frozen=True)
class Effect:
    """A named departure of a machine from its nominal simulation.

    Args:
        name: the contract's name.
        stage: where in the chain it acts.
        target: what an instance is attached to.
        slots: numbers read by the compiled step, neutral values included.
        forms: ways to parametrise the slots, simplest first.
        equation: what it computes, in one line.
        source: paper, book or data sheet.
        excited_by: what a recording must contain to show it.
        confused_with: effects that look alike; :mod:`sysid.effects.separators` says what separates them.
        generalises: simpler effects that it contains as special cases: it has to predict clearly better than they do.
        need: the same as ``excited_by``, to be counted.
        actuations: the kinds of axis that can have it (empty: not an axis effect).
        memory: step time [s] → number of state values the step keeps.
        sides: admissible places where the contract leaves two open.
    """

    name: str
    stage: Stage
    target: TargetKind
    slots: tuple[Slot, ...]
    forms: tuple[Form, ...]
    equation: str
    source: str
    excited_by: str
    need: Need
    confused_with: tuple[str, ...] = ()
    actuations: tuple[Actuation, ...] = ()
    memory: Callable[[float], int] = lambda dt: 0
    sides: tuple[Literal["drive", "structure"], ...] = ()
    generalises: tuple[str, ...] = ()

    def form_of(self, names: frozenset[str]) -> Form | None:
        """The form whose parameters are exactly ``names``."""
        for form in self.forms:
            if frozenset(form.names) == names:
                return form
        return None
