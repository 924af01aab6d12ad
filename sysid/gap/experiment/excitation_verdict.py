"""Excitation verdicts before any fit: for each effect that the machine admits, whether the recordings excite it.

They equal the excitation that :func:`sysid.gap.find_gap` reports: same counts, recordings and candidates.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from sysid.datasets.checks.roles import unmet_need
from sysid.datasets.recording import Dataset
from sysid.effects import CATALOGUE, Effect, effect_named
from sysid.gap.excitation import advice, excitation_at, excitation_of, measured_signals, recording_for
from sysid.gap.prepare.case import Case, Stage, stage_candidates, stage_split
from sysid.gap.problem import problems_of, split_of
from sysid.gap.result import Excitation
from sysid.machine import EffectKey, Machine
from sysid.machine.rigid_body import moves_masses
from sysid.names import listed
from sysid.plant import Model, Plant, compile_plant
from sysid.signals import axis_signal, point_signals, split_signal

VerdictStatus = Literal["ready", "lacking", "hidden"]


@dataclass(frozen=True)
class ExcitationVerdict:
    """Whether the recordings excite one effect at one place.

    Args:
        stage: where it is tested; ``side`` of the joint sensor where the effect has two places.
        status: ``ready``: sufficient; ``lacking``: more of the right motion is needed; ``hidden``: not observable, with these
            sensors and this description of the machine.
        have, need: of ``unit``, in the fit and selection recordings; None where hidden.
        text: the verdict in words: the count and what to record, or why the effect is not observable.
        record: what to record; empty unless lacking.
    """

    name: str
    target: str
    stage: str
    side: str | None
    status: VerdictStatus
    have: float | None
    need: float | None
    unit: str
    text: str
    record: str = ""


@dataclass(frozen=True)
class RecordingRequest:
    """One recording to make, and the effects that it excites: (name, target)."""

    record: str
    effects: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class ExcitationReport:
    """The excitation verdicts of a dataset, in the order of the signal chain.

    Args:
        counted: fit and selection recordings, in which excitation is counted; the held-out ones are not used before the proof.
        notes: reasons that would stop the gap workflow altogether.
    """

    dataset: str
    plant: str
    counted: tuple[str, ...]
    verdicts: tuple[ExcitationVerdict, ...]
    notes: tuple[str, ...] = ()

    def of(self, status: VerdictStatus) -> tuple[ExcitationVerdict, ...]:
        return tuple(verdict for verdict in self.verdicts if verdict.status == status)

    @property
    def requests(self) -> tuple[RecordingRequest, ...]:
        """Recording requests by number of effects, the largest first; axes that need the same recording are merged."""
        targets: dict[tuple[str, str], list[str]] = {}
        for verdict in self.of("lacking"):
            targets.setdefault((verdict.name, effect_named(verdict.name).need.advice), []).append(verdict.target)
        wanted: dict[tuple[str, tuple[str, ...]], list[str]] = {}
        for (name, words), places in targets.items():
            wanted.setdefault((words, tuple(dict.fromkeys(places))), []).append(name)
        requests = [
            RecordingRequest(words.format(axis=listed(places)), tuple((name, place) for name in names for place in places))
            for (words, places), names in wanted.items()
        ]
        return tuple(sorted(requests, key=lambda request: -len(request.effects)))

    def to_json(self) -> dict[str, Any]:
        return {
            "schema": 1,
            "dataset": self.dataset,
            "plant": self.plant,
            "counted": list(self.counted),
            "verdicts": [asdict(verdict) for verdict in self.verdicts],
            "record": [
                {"text": request.record, "effects": [{"name": name, "target": target} for name, target in request.effects]}
                for request in self.requests
            ],
            "notes": list(self.notes),
        }


def excitation_report(dataset: Dataset, plant: Plant) -> ExcitationReport:
    """Which effects the recordings excite.

    Args:
        plant: the simulation under test; its knowledge of the machine (linkages) determines which effects can be tested.
    """
    model, machine, split, notes = compile_plant(plant), plant.machine, split_of(dataset), []
    need = unmet_need(dataset)
    if need is not None:
        notes.append(need.text)
    if not split.fit or not split.select or not split.held_out:
        everything = dataset.of_kind("motion")
        split = replace(split, fit=everything, select=(), held_out=())
    case = Case(dataset, plant, plant.vector(), {}, split, 0)
    stages = []
    for problem in problems_of(model, dataset):
        stage = Stage(problem, stage_split(case, problem), np.ones(len(problem.signals)), case.theta)
        if stage.split.fit:
            stages.append(stage)
    if not stages and need is None:
        notes.append("no stage is measured at both its ends: commands and the motion that they cause are needed")
    found: dict[EffectKey, ExcitationVerdict] = {}
    aliases: dict[tuple[str, str], tuple[str, str]] = {}
    for stage in stages:
        for candidate in stage_candidates(case, stage):
            aliases |= dict.fromkeys(candidate.aliases, (candidate.effect.name, candidate.target))
            if candidate.key not in found:  # the same for all forms of an effect
                item = excitation_of(candidate, stage.split.seen, machine)
                found[candidate.key] = _counted(item, stage.problem.stage, candidate.side, machine)
    measured = measured_signals(split.seen)
    known = [axis_signal(axis.name, quantity) for axis in machine.axes for quantity in ("cylinder", "joint")]
    verdicts, sensors = list(found.values()), [signal for signal in known if signal in measured]
    for effect in CATALOGUE:
        if effect.target == "signal" and not effect.fitted:  # it is estimated from the readings
            items = [excitation_at(effect, signal, split.seen, machine) for signal in sensors]
            verdicts += [_counted(item, "sensor", None, machine) for item in items]
    there = {(verdict.name, verdict.target, verdict.side) for verdict in verdicts}
    reasons = _Reasons(dataset, model, aliases)
    for effect in CATALOGUE:
        for target, side in _places(effect, machine, dataset, sensors):
            if (effect.name, target, side) not in there:
                verdicts.append(reasons.hidden(effect, target, side))
    plant_name = plant.reference or "nominal"
    return ExcitationReport(dataset.reference, plant_name, tuple(r.name for r in split.seen), tuple(verdicts), tuple(notes))


def _counted(item: Excitation, stage: str, side: str | None, machine: Machine) -> ExcitationVerdict:
    status: VerdictStatus = "ready" if item.sufficient else "lacking"
    text, wanted = advice(item, machine), recording_for(item.name, item.target)
    if item.sufficient:
        text, wanted = text.removesuffix(wanted).rstrip(" ."), ""
    return ExcitationVerdict(item.name, item.target, stage, side, status, item.have, item.need, item.unit, text, wanted)


def _places(effect: Effect, machine: Machine, dataset: Dataset, sensors: Sequence[str]) -> Iterator[tuple[str, str | None]]:
    """Targets and sides at which the machine admits the effect, observable or not; ``sensors``: measured signals."""
    of_servos = "servo" in effect.actuations and moves_masses(machine, "servo")
    if effect.of_links and not (effect.fitted and (of_servos or moves_masses(machine))):
        return
    if effect.target == "axis":
        for axis in machine.axes:
            if axis.actuation in effect.actuations:
                yield from ((axis.name, side) for side in effect.sides or (None,))
    elif effect.target == "signal":
        yield from ((signal, None) for signal in sensors)
    elif effect.target == "stream":
        for stream, signals in dataset.streams.items():
            if not any(split_signal(signal)[1] == "command" for signal in signals):
                yield stream, None
    elif effect.target != "machine" or sum(axis.actuation == "velocity" for axis in machine.axes) > 1:
        yield effect.target, None


class _Reasons:
    """Reasons why an effect is not observable with these sensors."""

    def __init__(self, dataset: Dataset, model: Model, aliases: Mapping[tuple[str, str], tuple[str, str]]) -> None:
        self.machine, self.model, self.aliases = model.machine, model, aliases
        self.measured = measured_signals(dataset.recordings)

    def hidden(self, effect: Effect, target: str, side: str | None) -> ExcitationVerdict:
        stage = self._stage(effect, target, side)
        reason = self._missing(stage, target) or self._reason(effect, target, side)
        return ExcitationVerdict(effect.name, target, stage, side, "hidden", None, None, "", reason)

    def _stage(self, effect: Effect, target: str, side: str | None) -> str:
        if side == "structure":
            return "end_effector"
        if side == "drive":
            axis = self.machine.axis(target)
            return "joint" if axis.drives == "cylinder" else "force" if axis.actuation == "force" else "command"
        return effect.stage

    def _missing(self, stage: str, target: str) -> str:
        """Signals or descriptions that the stage lacks; empty if none."""
        machine = self.machine
        if stage == "sensor":
            owner = split_signal(target)[0]
            return self._missing("joint", owner) if owner in machine.axis_names and target.endswith(".cylinder") else ""
        if stage in ("end_effector", "tool") and machine.kinematics() is None:
            return "machine.toml names no URDF"
        axes = [axis for axis in machine.axes if target in (axis.name, "machine")]
        driven = [signal for axis in axes for signal in (axis_signal(axis.name, "command"), axis.driven)]
        needed = {
            "command": driven,
            "force": driven,
            "joint": [axis_signal(target, "cylinder"), axis_signal(target, "joint")],
            "links": [axis_signal(name, part) for name in machine.axis_names for part in ("command", "joint")],
            "end_effector": [*(axis_signal(name, "joint") for name in machine.axis_names), *point_signals("ee")],
            "tool": [*point_signals("ee"), *point_signals("tool")],
        }
        missing = self._not_measured(needed.get(stage, []))
        if not missing and stage == "joint" and target not in self.model.linked:
            known = "a linkage in machine.toml, or sysid fit actuator"
            return f"how the cylinder of {target} moves the joint is not known: {known}"
        return missing

    def _not_measured(self, signals: Sequence[str]) -> str:
        missing = list(dict.fromkeys(signal for signal in signals if signal not in self.measured))
        for point in ("ee", "tool"):
            if set(point_signals(point)) <= set(missing):
                missing = [point, *(s for s in missing if s not in point_signals(point))]
        return f"{listed(missing)} {'is' if len(missing) == 1 else 'are'} not measured" if missing else ""

    def _reason(self, effect: Effect, target: str, side: str | None) -> str:
        if (effect.name, target) in self.aliases:
            name, place = self.aliases[effect.name, target]
            return f"indistinguishable from {name} on {place} in every pose, which represents it"
        if side == "drive" and self.machine.axis(target).actuation == "force":
            return "a force axis is compared by its force at measured motion, independent of compliance ahead of the sensor"
        if effect.ratio_of == "inertia" and (axis := self.machine.axis(target)).actuation == "force" and axis.inertia is None:
            return "machine.toml states no inertia of its rotor, which is adjusted without a name"
        if effect.in_links and moves_masses(self.machine):
            return "the adjusted parameters of its links contain it"
        scales = {parameter.scale for form in effect.forms for parameter in form.parameters}
        if "response" in scales:
            return "its force responds to its motion like that of a rigid drive, up to the frequencies that the motion contains"
        if effect.ratio_of == "mass":
            return "gravity puts no load on it"
        if "1/load" in scales:
            return "gravity puts no load on it" if self.machine.kinematics() is not None else "machine.toml names no URDF"
        if effect.target == "signal":
            return "no other sensor measures the same: a wrong gain or zero of the simulation would look the same"
        if effect.target == "stream":
            return "no stage compares its signals with those of another clock"
        return "its stage is not measured at both ends at the same time"
