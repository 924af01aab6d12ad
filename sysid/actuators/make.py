"""A card from a result of the gap workflow: the plant of the actuators alone, the evidence, and values estimated again."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sysid.actuators.card import ActuatorCard, CardData, CardError, CardReplay, NotShown, Repetition
from sysid.datasets import Dataset
from sysid.effects import effect_named, inertial_error
from sysid.effects.wording import title_of
from sysid.gap import GapResult
from sysid.gap.result import WrittenEffect
from sysid.machine import Axis, KnownEffect, machine_from_files
from sysid.machine.description import ServoLaw
from sysid.names import listed
from sysid.plant import Plant
from sysid.plant.plant import effect_key
from sysid.quoting import toml_key, toml_value
from sysid.signals import axis_signal, split_signal

#: Inertia of a force axis of which no recording shows one [kg or kg·m²].
ASSUMED_INERTIA = 1.0


def card_of(
    name: str,
    title: str,
    dataset: Dataset,
    result: GapResult,
    repaired: Plant,
    *,
    source: str,
    licence: str,
    recipe: str,
    conditions: Sequence[str],
    default: str,
    made: Mapping[str, Any],
    loops: Mapping[str, ServoLaw] = {},
    beside: Sequence[str] = (),
    repeated: Sequence[Repetition] = (),
    replays: Sequence[CardReplay] = (),
) -> ActuatorCard:
    """The card of a repair.

    Args:
        dataset: the one of ``result``; ``repaired``: the plant that it writes.
        default: what the plant under test is, in words.
    """
    plant, machine_only, assumed = alone(repaired)
    recordings = dataset.of_kind("motion")
    data = CardData(
        source, licence, recipe, dataset.reference, dataset.digest, tuple(r.name for r in recordings),
        tuple(result.held_out_recordings), sum(len(r) / r.rate_hz for r in recordings), tuple(conditions),
    )  # fmt: skip
    own = {effect_key(item) for item in plant.effects}
    values = tuple(item for item in result.written if effect_key(_known(item)) in own)
    floors = {item.signal: item.floor_source for item in result.agreement}
    errors = tuple(
        CardError(
            signal, dataset.units.get(signal) or dataset.machine.expected_unit(signal) or "1", before,
            result.gap.after[signal], result.gap.noise_floor[signal], floors.get(signal, "unknown"),
        )
        for signal, before in result.gap.before.items() if dataset.machine.has_axis(split_signal(signal)[0])
    )  # fmt: skip
    lineage = {"dataset": dataset.reference, "dataset_digest": dataset.digest, "recipe": recipe}
    origin = lineage | {key: value for key, value in made.items() if isinstance(value, str)}
    content = json.loads(replace(plant, origin=origin).to_files()["plant.json"])
    return ActuatorCard(
        1, name, title, data, default, values, errors, content, dict(made), tuple(_not_shown(result)),
        machine_only, assumed, dict(loops), tuple(beside), tuple(repeated), tuple(replays),
    )  # fmt: skip


def alone(plant: Plant) -> tuple[Plant, tuple[str, ...], tuple[str, ...]]:
    """The plant of the actuators without links: effects that belong to those, and values that are assumed, in words.

    A force axis has the inertia of ``machine.toml`` and of its rotor, as far as it was adjusted.
    """
    machine = plant.machine
    rotors = {item.target: item for item in plant.effects if item.name == inertial_error.EFFECT.name}
    axes, assumed = [], []
    for axis in machine.axes:
        inertia, joint = axis.inertia, axis.joint_type
        if machine.urdf is not None:
            joint = "prismatic" if machine.expected_unit(axis_signal(axis.name, "joint")) == "m" else "revolute"
        if axis.actuation == "force":
            rotor = rotors[axis.name].parameters["rotor"] if axis.name in rotors else 0.0
            inertia = (inertia or 0.0) + float(np.asarray(rotor))
            if inertia <= 0.0:
                inertia = ASSUMED_INERTIA
                assumed.append(f"inertia of {axis.name}: {inertia:g} {'kg' if joint == 'prismatic' else 'kg·m²'}")
        axes.append(replace(axis, joint=None, joint_type=joint, inertia=inertia))
    if machine.urdf is None:
        return plant, (), tuple(assumed)
    kept, left = list[KnownEffect](), list[KnownEffect]()
    for item in plant.effects:
        effect = effect_named(item.name)
        of_axis = effect.target == "axis" and effect.stage in ("command", "force", "joint")
        (kept if of_axis else left).append(item)
    text = _machine_text(plant, axes)
    bare = machine_from_files({"machine.toml": text}, f"actuators of {machine.name}")
    known = plant.uncertainty.without({effect_key(item) for item in left})
    names = tuple(f"{title_of(effect_named(e.name), e.target, machine)} of {e.target}" for e in left)
    return Plant(bare, {}, tuple(kept), {}, known, plant.origin), names, tuple(assumed)


def _machine_text(plant: Plant, axes: Sequence[Axis]) -> str:
    """``machine.toml`` of axes without a URDF."""
    machine = plant.machine
    lines = ["schema = 1", f"name = {toml_value(machine.name)}", f"rate_hz = {machine.rate_hz}"]
    lines += [f"convention = {toml_value(machine.convention)}"] if machine.convention is not None else []
    for axis in axes:
        names = ("name", "actuation", "drives", "joint_type", "inertia", "limits", "stroke")
        keys = {key: getattr(axis, key) for key in names} | ({"gain": axis.gain} if axis.actuation == "velocity" else {})
        lines += ["", "[[axes]]", *(f"{key} = {toml_value(value)}" for key, value in keys.items() if value is not None)]
        if axis.servo is not None:
            law = {key: getattr(axis.servo, key) for key in ("kp", "kv", "force_limit")}
            parts = (f"{key} = {toml_value(value)}" for key, value in law.items() if value is not None)
            lines.append(f"servo = {{{', '.join(parts)}}}")
    noise = [f"{toml_key(key)} = {value}" for key, value in machine.noise.items() if key.endswith(".joint")]
    return "\n".join([*lines, *(["", "[noise]", *noise] if noise else []), ""])


def _known(item: WrittenEffect) -> KnownEffect:
    return KnownEffect(item.name, item.target, dict(item.parameters), item.side)  # type: ignore[arg-type]


def _not_shown(result: GapResult) -> Iterator[NotShown]:
    """Effects that are not excited, tied or nearly named and not written, and errors without a name."""
    written = {(item.name, item.target) for item in result.written}
    unseen: dict[tuple[str, str], list[str]] = {}
    for item in result.excitation:
        if not item.sufficient:
            unseen.setdefault((item.name, f"too little excitation ({item.unit})"), []).append(item.target)
    for tie in result.ambiguous:
        others = listed([f"{name} of {target}" for name, target in tie[1:]])
        unseen[tie[0][0], f"cannot be distinguished from {others}"] = [tie[0][1]]
    for miss in result.near_misses:
        if (miss.name, miss.target) not in written:
            unseen.setdefault((miss.name, miss.lacks), []).append(miss.target)
    for (name, why), targets in unseen.items():
        yield NotShown(name, tuple(targets), why)
    for error in result.unnamed:
        yield NotShown("unnamed", (error.target,), f"{error.stage} stage: {error.form}")


def repetitions(card: Sequence[WrittenEffect], again: GapResult, recordings: str) -> Iterator[Repetition]:
    """The parameters of a card with an interval, as another result has them.

    Args:
        again: from recordings that the values of the card are not from.
    """
    found = {(item.name, item.target, item.side): item for item in again.written}
    for item in card:
        other = found.get((item.name, item.target, item.side))
        for key, ends in item.interval95.items():
            value = None if other is None else other.parameters.get(key)
            if other is None or value is None:
                yield Repetition(recordings, item.kind, item.name, item.target, key, None, inside=False, overlaps=False)
                continue
            (low, high), own = np.asarray(ends, dtype=np.float64), np.asarray(value, dtype=np.float64)
            first, last = np.asarray(other.interval95.get(key, (own, own)), dtype=np.float64)
            inside, overlaps = ((low <= own) & (own <= high)).all(), ((first <= high) & (last >= low)).all()
            yield Repetition(recordings, item.kind, item.name, item.target, key, float(own), bool(inside), bool(overlaps))
