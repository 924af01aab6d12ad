"""What an effect is: a name from the contract, its words, its parameters, what shows it, its slots in a compiled plant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

Stage = Literal["command", "force", "joint", "end_effector", "tool", "sensor"]
TargetKind = Literal["axis", "machine", "base", "tool", "signal", "stream"]
Actuation = Literal["velocity", "position", "force"]
Part = Literal["valve", "cylinder", "joint", "link", "base", "tool", "pump", "sensor", "clock"]
#: What :func:`sysid.testing.check_effect` asks of an effect unless it is exempt, since it cannot be so by its nature.
Promise = Literal["causal", "finite", "time_invariant", "memoryless"]


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
        title: its name in reports and on the console.
        sentences: templates over ``{target}`` and the parameters; a report uses the first one whose parameters are all known.
        beside: another effect on the same target → the sentence where that one changes what this one's value means.
        part: where on the machine it is; without hydraulics a drive is in the place of valve and cylinder.
        stage: where in the chain it acts.
        target: what an instance is attached to.
        slots: numbers read by the compiled step, neutral values included.
        forms: ways to parametrise the slots, simplest first.
        equation: what it computes, in one line.
        source: paper, book or data sheet.
        excited_by: what a recording must contain to show it.
        confused_with: effect that looks alike → what separates the two. Each pair is written once, in either file:
            :func:`sysid.effects.catalogue.confusions` reads it from both sides.
        generalises: simpler effects that it contains as special cases: it has to predict clearly better than they do.
        need: the same as ``excited_by``, to be counted.
        actuations: the kinds of axis that can have it (empty: not an axis effect).
        memory: step time [s] → number of state values the step keeps.
        sides: admissible places where the contract leaves two open.
        example: values that show well in the picture of its page; by default values from which a fit starts.
        exempt: properties that it cannot have: stamps may lie before the motion, oil tells the time.
        rate_independent: it does not depend on how fast its input is run through.
        fitted: whether a fit searches its values; those of a sensor's resolution are read off the readings.
        surrogate_test: a surrogate model of a simulator consists of the effects that have this value: at it each of them, as an
            input effect, tests the surrogate.
    """

    name: str
    title: str
    sentences: tuple[str, ...]
    part: Part
    stage: Stage
    target: TargetKind
    slots: tuple[Slot, ...]
    forms: tuple[Form, ...]
    equation: str
    source: str
    excited_by: str
    need: Need
    beside: Mapping[str, str] = field(default_factory=dict, hash=False)
    confused_with: Mapping[str, str] = field(default_factory=dict, hash=False)
    actuations: tuple[Actuation, ...] = ()
    memory: Callable[[float], int] = lambda dt: 0
    sides: tuple[Literal["drive", "structure"], ...] = ()
    generalises: tuple[str, ...] = ()
    example: Mapping[str, float | list[float]] = field(default_factory=dict, hash=False)
    exempt: tuple[Promise, ...] = ()
    rate_independent: bool = False
    fitted: bool = True
    surrogate_test: float | None = None

    def form_of(self, names: frozenset[str]) -> Form | None:
        """The form whose parameters are exactly ``names``."""
        for form in self.forms:
            if frozenset(form.names) == names:
                return form
        return None
