"""Candidates of a stage: every effect of the catalogue at every admissible place.

Effects that no recording distinguishes: they are tested and reported once, under one name.

Kinematic effects are compared in every pose, effects of a servo by its equation.

A longer stick, a zero offset of the telescope and a bias of its sensor move the end effector in the same way in every pose.
Such aliases are determined from the kinematics, at poses over the whole ranges of the joints; effects that only the recordings
do not distinguish are ambiguous instead. Special cases are determined likewise: a zero offset of the first joint turns
everything behind it, as a misaligned base does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.effects import (
    CATALOGUE,
    Effect,
    Form,
    Parameter,
    armature_error,
    damping_error,
    inertial_error,
    joint_offset,
    link_length_error,
    link_mass_error,
    sensor_bias,
    viscous_friction,
)
from sysid.effects.effect import Stage
from sysid.machine import Axis, EffectKey, KnownEffect, Machine
from sysid.plant import Model, Plant
from sysid.plant.layout import parameter_indices
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: A parameter in units of one over the typical load is searched up to this multiple of its largest start value.
LOAD_BOUND = 50.0


@dataclass(frozen=True)
class Unknown:
    """One number that a fit may change.

    Args:
        key: public parameter name, with ``[i]`` for a component of a vector.
        places: indices into ``theta`` that take its value.
        nominal: its value in the plant under test.
        negligible: a negligible change; steps and tolerances of fits derive from it.
        stepwise: the output is not differentiable by it; a fit searches it on a grid as well.
        reciprocal: the effect is absent at the upper bound, which stands for infinity: its size is the inverse of the value.
    """

    key: str
    places: tuple[int, ...]
    bounds: tuple[float, float]
    nominal: float
    negligible: float
    stepwise: bool = False
    reciprocal: bool = False


def sizes_of(unknowns: Sequence[Unknown], values: Array) -> tuple[Array, Array]:
    """Sizes of ``values`` (k,) on a scale on which no effect is absent at infinity, and the change of each by its value, (k,).

    A frequency, or a limit, of 40 with a standard error of 20 may be any larger one.
    """
    inverse = np.array([u.reciprocal for u in unknowns], dtype=bool)
    safe = np.where(inverse, values, 1.0)
    return np.where(inverse, 1.0 / safe, values), np.where(inverse, 1.0 / safe**2, 1.0)


@dataclass(frozen=True)
class Candidate:
    """One effect in one form at one place.

    An effect that the plant has already is ``known``: another value of it, or a richer form, may be missing.
    ``aliases``: (name, target) of effects that no recording can distinguish from it; ``special``: of those that are special
    cases of it on this machine.
    """

    effect: Effect
    form: Form
    target: str
    side: str | None
    unknowns: tuple[Unknown, ...]
    starts: tuple[tuple[float, ...], ...]
    known: bool = False
    aliases: tuple[tuple[str, str], ...] = ()
    special: tuple[tuple[str, str], ...] = ()

    @property
    def key(self) -> EffectKey:
        """Name, target and side, which all forms of an effect share; a model contains at most one of these forms."""
        return self.effect.name, self.target, self.side

    @property
    def label(self) -> str:
        """For tables: ``backlash(slew, drive)``, with the form where it is not the simplest."""
        side = f", {self.side}" if self.side else ""
        form = "" if self.form is self.effect.forms[0] else f" [{', '.join(self.form.names)}]"
        return f"{self.effect.name}({self.target}{side}){form}"

    @property
    def absent(self) -> list[float]:
        """Value of each unknown at which the effect is absent."""
        neutral = {slot.name: slot.neutral for slot in self.effect.slots}
        return [neutral[slots[0]] for parameter in self.form.parameters for slots in parameter.components]

    def contains(self, other: Candidate) -> bool:
        """Whether ``other`` is a special case of this one."""
        same = other.effect.name in self.effect.generalises and other.target == self.target
        return same or (other.effect.name, other.target) in self.special

    def extends(self, other: Candidate) -> bool:
        """Whether ``other`` is a form of the same effect with fewer values."""
        return self.key == other.key and len(self.unknowns) > len(other.unknowns)

    def instance(self, values: Array) -> KnownEffect:
        """The effect with these values, for a plant."""
        parameters: dict[str, float | list[float]] = {}
        k = 0
        for parameter in self.form.parameters:
            width = len(parameter.components)
            part = [float(v) for v in values[k : k + width]]
            parameters[parameter.name] = part[0] if width == 1 else part
            k += width
        return KnownEffect(self.effect.name, self.target, parameters, self.side)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Scales:
    """What the data show before any fit.

    Args:
        force: typical force [N or N·m], zero for none.
        loads: typical gravity load on each axis [N·m or N], zero for no load.
        responses: (effect, axis) → its parameters that the frequency response of the axis shows, by name; axes that respond
            like rigid ones are absent.
    """

    force: float = 1.0
    loads: Mapping[str, float] = field(default_factory=dict)
    responses: Mapping[tuple[str, str], Mapping[str, float]] = field(default_factory=dict)

    def known_for(self, effect: Effect, target: str) -> bool:
        """Whether the data contain the unit of the effect's parameters (force, load), or their start values (response)."""
        needed = {parameter.scale for form in effect.forms for parameter in form.parameters}
        return (
            ("force" not in needed or self.force > 0.0)
            and ("1/load" not in needed or bool(self.loads.get(target)))
            and ("response" not in needed or (effect.name, target) in self.responses)
        )

    def starts(self, parameter: Parameter, target: str) -> tuple[float, ...]:
        """Values from which a fit of the parameter starts."""
        return tuple(start * self.unit(parameter, target) for start in parameter.starts)

    def unit(self, parameter: Parameter, target: str) -> float:
        """Unit of the parameter's start values and negligible change."""
        if parameter.scale == "force":
            return self.force
        return 1.0 / self.loads[target] if parameter.scale == "1/load" else 1.0


def candidates_at(
    plant: Plant, theta: Array, stages: Sequence[Stage], targets: tuple[str, ...], scales: Scales | None = None
) -> list[Candidate]:
    """All candidates of a problem.

    Args:
        stages: stages of the chain whose effects it shows.
        theta: vector of the plant under test; its values are the nominal ones.
        targets: axes, ``machine``, ``base``, ``ee``, ``tool`` or signals that belong to the stage's problem.
    """
    found = []
    scales = scales or Scales()
    for effect in CATALOGUE:
        for target in targets if effect.fitted else ():
            if not _fits(effect, target, stages, plant) or not scales.known_for(effect, target):
                continue
            for side in _sides(effect, stages, target, plant.machine):
                found += [
                    _candidate(plant, theta, effect, form, target, side, scales) for form in _forms(plant, effect, target, side)
                ]
    return found


def _forms(plant: Plant, effect: Effect, target: str, side: str | None) -> list[Form]:
    """The forms of an effect; one that the plant has already keeps all slots that it has."""
    present = plant.effect(effect.name, target, side)
    if present is None:
        return list(effect.forms)
    complete = [form for form in effect.forms if len(form.slots) == len(effect.slots)]
    return complete or [form for form in effect.forms if set(form.names) == set(present.parameters)]


def adjusted_link(plant: Plant, theta: Array, axis: str) -> Candidate:
    """The inertial parameters of a link, which are adjusted and never named."""
    effect = inertial_error.EFFECT
    return _candidate(plant, theta, effect, effect.forms[0], axis, None, Scales())


def _fits(effect: Effect, target: str, stages: Sequence[Stage], plant: Plant) -> bool:
    machine = plant.machine
    if effect.target != _kind(target, plant):
        return False
    if effect.described_only and plant.effect(effect.name, target) is None:
        return False
    if effect.target == "axis" and machine.axis(target).actuation not in effect.actuations:
        return False
    if effect.sides:
        return bool(_sides(effect, stages, target, machine))
    return effect.stage in stages or effect.stage == "sensor"


def _kind(target: str, plant: Plant) -> str:
    """Kind of target of a name."""
    if target in ("machine", "base", "ee", "tool"):
        return target
    if target in plant.machine.axis_names:
        return "axis"
    return "stream" if target in plant.streams else "signal"


def _sides(effect: Effect, stages: Sequence[Stage], target: str, machine: Machine) -> tuple[str | None, ...]:
    """Sides of an effect that stages show: backlash ahead of a directly driven joint shows in its command stage."""
    if not effect.sides:
        return (None,)
    drives = machine.axis(target).drives
    if "command" in stages:
        return ("drive",) if drives == "joint" else ()
    if "joint" in stages:
        return ("drive",) if drives == "cylinder" else ()
    return ("structure",) if "end_effector" in stages else ()


def _candidate(
    plant: Plant, theta: Array, effect: Effect, form: Form, target: str, side: str | None, scales: Scales
) -> Candidate:
    unknowns: list[Unknown] = []
    starts: list[tuple[float, ...]] = []
    neutral = {slot.name: slot.neutral for slot in effect.slots}
    for parameter in form.parameters:
        places = parameter_indices(plant.machine.axis_names, effect.name, target, side, parameter.name, plant.streams)
        unit = scales.unit(parameter, target)
        for k, group in enumerate(places):
            key = parameter.name if len(places) == 1 else f"{parameter.name}[{k}]"
            nominal = float(theta[group[0]])
            negligible = parameter.negligible * unit
            bounds = parameter.bounds
            if parameter.scale == "1/load":  # the range follows from the load: an elbow of a servo arm and a crane boom differ
                most = LOAD_BOUND * max(abs(start) for start in parameter.starts) * unit
                bounds = max(bounds[0], -most), min(bounds[1], most)
            infinite = neutral[parameter.components[k][0]] == bounds[1]
            unknowns.append(Unknown(key, tuple(group), bounds, nominal, negligible, parameter.stepwise, infinite))
            starts.append(scales.starts(parameter, target))
    count = max(len(s) for s in starts)
    rows = tuple(tuple(s[min(i, len(s) - 1)] for s in starts) for i in range(count))
    shown = scales.responses.get((effect.name, target))
    if shown is not None:
        row = tuple(shown[parameter.name] for parameter in form.parameters)
        rows = (row,) if any(p.scale == "response" for p in form.parameters) else (*rows, row)
    known = plant.effect(effect.name, target, side) is not None
    return Candidate(effect, form, target, side, tuple(unknowns), rows, known=known)


# -- effects that no recording distinguishes -----------------------------------------------------------------------------------

#: Poses at which effects are compared.
POSES = 24
#: Largest sine of the angle between the responses to two aliases, and step of the responses in the negligible change.
MAX_SINE, STEP = 1e-5, 0.01
#: Preferred names, in this order: a length before a telescope is that of the revolute axis that carries it (contract).
ORDER = tuple(each.EFFECT.name for each in (link_length_error, joint_offset, sensor_bias))
#: Range of an axis without limits [rad or m].
UNLIMITED = (-1.0, 1.0)


def without_aliases(candidates: Sequence[Candidate], model: Model) -> list[Candidate]:
    """The candidates of the end-effector stage, with aliases merged into one candidate and special cases noted."""
    single = [c for c in candidates if c.effect.name in ORDER and len(c.unknowns) == 1]
    if len(single) < 2 or not model.posed:
        return list(candidates)
    poses = _poses(model.machine.axes)
    responses = {id(candidate): _response(model, poses, candidate.unknowns[0]) for candidate in single}
    aliases: dict[int, list[tuple[str, str]]] = {}  # of the preferred candidates
    for candidate in sorted(single, key=lambda c: ORDER.index(c.effect.name)):
        response = responses[id(candidate)]
        same = [first for first in aliases if 1.0 - float(response @ responses[first]) ** 2 < MAX_SINE**2]
        if same:
            aliases[same[0]].append((candidate.effect.name, candidate.target))
        else:
            aliases[id(candidate)] = []
    by_place = {(c.effect.name, c.target): responses[id(c)] for c in single}
    found = []
    for candidate in candidates:
        if id(candidate) in responses and id(candidate) not in aliases:
            continue
        own = tuple(aliases.get(id(candidate), ()))
        found.append(_with_special_cases(replace(candidate, aliases=own) if own else candidate, by_place, model, poses))
    return found


def without_servo_aliases(candidates: Sequence[Candidate], machine: Machine, spins: bool) -> list[Candidate]:
    """The candidates of the command stage of a servo axis, where friction and the controller may be the same.

    Viscous friction of one value acts like damping of the controller: only damping counts towards a force limit. Without a
    limit, the two are one candidate, ``damping_error``, which can be less than described as well.

    Args:
        spins: whether the mass of the axis' own link acts like an armature on it, and on no other axis.
    """
    found = []
    dampings = {c.target for c in candidates if c.effect is damping_error.EFFECT}
    unlimited = {axis.name for axis in machine.axes if axis.servo is not None and axis.servo.force_limit is None}
    for candidate in candidates:
        same = candidate.target in dampings & unlimited
        if same and candidate.effect is damping_error.EFFECT:
            found.append(replace(candidate, aliases=((viscous_friction.EFFECT.name, candidate.target),)))
        elif spins and candidate.effect is armature_error.EFFECT:
            found.append(replace(candidate, aliases=((link_mass_error.EFFECT.name, candidate.target),)))
        elif not (same and candidate.effect is viscous_friction.EFFECT and len(candidate.unknowns) == 1):
            found.append(candidate)
    return found


def _with_special_cases(
    candidate: Candidate, responses: Mapping[tuple[str, str], Array], model: Model, poses: Recording
) -> Candidate:
    """The candidate of several parameters with the effects whose responses they span."""
    if len(candidate.unknowns) < 2:
        return candidate
    basis = np.linalg.qr(np.stack([_response(model, poses, unknown) for unknown in candidate.unknowns], axis=1))[0]
    special = tuple(
        key
        for key, response in responses.items()
        if float(response @ response) > 0.0 and float(np.linalg.norm(response - basis @ (basis.T @ response))) < MAX_SINE
    )
    return replace(candidate, special=special) if special else candidate


def _poses(axes: Sequence[Axis]) -> Recording:
    draw = np.random.default_rng(0)
    table = {"time": np.arange(POSES, dtype=np.float64)}
    for axis in axes:
        table[axis_signal(axis.name, "joint")] = draw.uniform(*(axis.limits or UNLIMITED), POSES)
    return Recording("poses", pd.DataFrame(table), 1.0, kind="poses")


def _response(model: Model, poses: Recording, unknown: Unknown) -> Array:
    """Motion of the end effector at all poses with a parameter, as a unit vector; zero where it does not move."""
    thetas = np.repeat(model.theta[None], 2, axis=0)
    thetas[1, list(unknown.places)] += STEP * unknown.negligible
    ends = model.tip(thetas, poses)
    moved: Array = (ends[1] - ends[0]).ravel()
    length = float(np.linalg.norm(moved))
    return moved / length if length > 0.0 else moved
