"""Definition of an effect: its name and texts, parameters, required excitation, and slots in a compiled plant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

Stage = Literal["command", "force", "links", "joint", "end_effector", "tool", "sensor"]
TargetKind = Literal["axis", "machine", "base", "ee", "tool", "signal", "stream"]
Actuation = Literal["velocity", "position", "force", "servo"]
#: Kind of drive of an axis, as :meth:`sysid.machine.Machine.drive_of` gives it.
Drive = Literal["hydraulic", "electric", "unknown"]
Part = Literal["valve", "cylinder", "joint", "link", "base", "tool", "pump", "sensor", "clock"]
#: Properties that :func:`sysid.testing.check_effect` checks, unless the effect is exempt by its nature.
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
        unit: SI; ``drive``, ``joint`` or ``signal`` stands for m or rad, the unit of that quantity of the target; ``command``
            for the unit of its command.
            Of two units with ``or`` the first is that of a prismatic axis, the second that of a revolute one.
        bounds: (low, high) of a fit.
        starts: start values of a fit.
        negligible: a negligible change, from which steps and tolerances of fits derive.
        scale: unit of ``starts`` and ``negligible``: the typical force in the data, or one over the typical gravity load; ""
            for SI values.
        stepwise: a small change may have no effect (a threshold between two samples of a command): a fit uses a grid.
        secondary: it determines how the effect acts, not how much, and has no meaning without the others.
        sets: for each component, the slots that take its value; by default the slot of the same name.
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
    scale: Literal["", "force", "1/load", "response"] = ""

    @property
    def components(self) -> tuple[tuple[str, ...], ...]:
        return self.sets or ((self.name,),)


@dataclass(frozen=True)
class Form:
    """One parametrisation of an effect; the first form of an effect is its simplest. A name means the same in all forms.

    Args:
        part: its place on the machine, where that of the effect does not fit.
    """

    parameters: tuple[Parameter, ...]
    part: Part | None = None

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def slots(self) -> tuple[str, ...]:
        """Slots that it writes; those of a richer form keep their neutral values."""
        return tuple(slot for parameter in self.parameters for group in parameter.components for slot in group)


@dataclass(frozen=True)
class Need:
    """Excitation that recordings must contain.

    Args:
        count: a count of :data:`sysid.gap.excitation.COUNTS`.
        least: required amount, in its unit.
        advice: what to record otherwise; ``{axis}`` stands for the target.
    """

    count: str
    least: float
    advice: str


@dataclass(frozen=True)
class Effect:
    """A named departure of a machine from its nominal simulation.

    Args:
        name: as in the contract.
        title: its name in reports and on the console.
        titles: its name on axes of an actuation or with a kind of drive where the title does not fit.
        sentences: templates over ``{target}`` and the parameters; a report uses the first one whose parameters are all known.
        sentences_by: those for an actuation or a kind of drive, which come before the others.
        beside: another effect on the same target → the sentence to use if that one changes the meaning of this one's value.
        part: its place on the machine; without hydraulics a drive replaces valve and cylinder.
        stage: its place in the chain.
        target: kind of target of an instance.
        slots: numbers read by the compiled step, with neutral values.
        forms: parametrisations of the slots, simplest first; forms with as many values are alternatives to each other.
        equation: in one line.
        source: paper, book or data sheet.
        excited_by: motion that excites it.
        confused_with: similar effect → what separates the two. Each pair is written once, in either file;
            :func:`sysid.effects.catalogue.confusions` combines both sides.
        generalises: simpler effects that are special cases of it: it has to predict clearly better.
        instead_of: effects of the same target in whose place it is compared, once a search without it has ended. It has to
            divide the variance that they leave by the price of an effect, or to predict as well with fewer effects
            (:mod:`sysid.gap.alternatives`).
        need: required excitation, as a count.
        actuations: kinds of axis that can have it (empty: not an axis effect).
        memory: step time [s] → number of state values of the step.
        sides: admissible places, if there are two.
        example: values of the picture on its page; by default start values.
        exempt: checked properties that it cannot have: stamps may lie before the motion, warm-up depends on time.
        rate_independent: the output depends on the path of the input only, not on its speed.
        proportional: it changes every speed by one share, whatever the command and the load.
        fitted: whether a fit estimates its values; the resolution of a sensor is estimated from its readings.
        described_only: it is tested only where the machine description contains it, with any value: other effects do the same
            where it is known to be absent.
        of_links: it acts by the torque of links with masses; without them it is absent, and an axis of an arm has no free run.
        ratio_of: what of the axis it is a ratio of; it is compared where the machine has that (mass: where it loads the axis).
        in_links: on an arm, the adjusted inertial parameters of its links contain it: it is compared on other axes.
        surrogate_test: value at which the effect, as an input effect, tests a surrogate model; the effects with one make up
            the surrogate.
    """

    name: str
    title: str
    sentences: tuple[str, ...]
    part: Part
    stage: Stage
    slots: tuple[Slot, ...]
    forms: tuple[Form, ...]
    equation: str
    source: str
    excited_by: str
    need: Need
    target: TargetKind = "axis"
    titles: Mapping[Actuation | Drive, str] = field(default_factory=dict, hash=False)
    sentences_by: Mapping[Actuation | Drive, tuple[str, ...]] = field(default_factory=dict, hash=False)
    beside: Mapping[str, str] = field(default_factory=dict, hash=False)
    confused_with: Mapping[str, str] = field(default_factory=dict, hash=False)
    actuations: tuple[Actuation, ...] = ()
    memory: Callable[[float], int] = lambda dt: 0
    sides: tuple[Literal["drive", "structure"], ...] = ()
    generalises: tuple[str, ...] = ()
    instead_of: tuple[str, ...] = ()
    example: Mapping[str, float | list[float]] = field(default_factory=dict, hash=False)
    exempt: tuple[Promise, ...] = ()
    rate_independent: bool = False
    proportional: bool = False
    fitted: bool = True
    described_only: bool = False
    of_links: bool = False
    ratio_of: Literal["", "inertia", "damping", "mass"] = ""
    in_links: bool = False
    surrogate_test: float | None = None

    def form_of(self, names: frozenset[str]) -> Form | None:
        """The form whose parameters are exactly ``names``."""
        return next((form for form in self.forms if frozenset(form.names) == names), None)

    def part_of(self, names: frozenset[str]) -> Part:
        """The place on the machine of the effect with the parameters ``names``."""
        form = self.form_of(names)
        return self.part if form is None or form.part is None else form.part
