"""Servo arms of a MuJoCo model: controllers, friction and masses are parameters of the model itself.

The plant that describes such a model moves as MuJoCo does, which is checked on the recordings. Effects, also those inside the
loops, are searched on that plant, in a fraction of the time that runs of the model take, and written into its actuators, joints
and bodies; those of sensors and of the kinematics into the file beside it. The written model is loaded again, and its gap on
held-out recordings measured with MuJoCo. A model that moves otherwise (springs, contacts) is run itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Recording
from sysid.effects import effect_named
from sysid.gap.adapters.mujoco.force_repair import machine_of
from sysid.gap.adapters.mujoco.native import LINEAR, Change, Place, write_inside
from sysid.gap.adapters.mujoco.repair import (
    RepairedModel,
    check_gap,
    check_other_file,
    known_effect,
    measured_gap,
    open_mujoco,
    read_side_file,
    relocate,
    side_file,
    write_side_file,
    write_spec,
)
from sysid.gap.adapters.mujoco.simulator import MujocoSimulator, drives_of
from sysid.gap.disagreement import run_rmse
from sysid.gap.prepare.noise import noise_levels
from sysid.gap.problem import split_of
from sysid.gap.result import GapResult
from sysid.machine import EffectKey, KnownEffect, Machine
from sysid.machine.sources.mjcf_model import load_mjcf, load_spec, mujoco_library
from sysid.names import listed
from sysid.plant import Plant, chain, compile_plant, free_run, nominal_plant
from sysid.plant.plant import effect_key
from sysid.plant.stretches import held_for
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Largest RMS difference between the motion of plant and model, as a share of the motion, where the sensor has less noise.
ALIKE = 1e-3
#: Why an effect inside the loop is left out.
NO_PLACE = "it acts inside the loop, and this model has no place for it; `sysid export --to mjcf` writes a model that has one"


def has_servos(machine: Machine) -> bool:
    """Whether every axis is a servo with its controller."""
    return all(axis.servo is not None for axis in machine.axes)


def open_servo_model(path: Path, dataset: Dataset, assets: Sequence[Path] = ()) -> Plant | str:
    """The plant of a model whose axes are all servos, with the effects in the file beside it; else why it cannot stand for it.

    Raises:
        InputError: not a file that MuJoCo compiles, or it is unstable.
        SettingsError: its axes are not those of the dataset.
    """
    machine = machine_of(path, dataset.machine, assets)
    if not has_servos(machine):
        return f"{listed([axis.name for axis in machine.axes if axis.servo is None])} is no servo of machine.toml"
    plant = nominal_plant(machine, streams=dataset.streams)
    simulator, noise = MujocoSimulator(path, machine, tuple(assets)), noise_levels(dataset)
    own = replace(plant, machine=replace(machine, convention=None))
    for recording in split_of(dataset).seen:
        ours, theirs = free_run(own, recording), simulator.simulate(recording)
        for axis in machine.axes:
            apart, size = _rms(ours[axis.driven] - theirs[axis.driven]), float(np.nanstd(theirs[axis.driven]))
            if apart > max(ALIKE * size, noise.get(axis.driven, 0.0)):
                unit = dataset.units.get(axis.driven, "")
                return (
                    f"in {recording.name} the motion of {axis.name} differs by {apart:.3g} {unit} from that of its controller, "
                    "masses and friction (springs, contacts, …)"
                )
    for item in read_side_file(path):
        plant = plant.with_effect(item)
    return plant


def _rms(values: Any) -> float:
    return float(np.sqrt(np.nanmean(np.asarray(values, dtype=np.float64) ** 2)))


def write_servo_model(
    model: Path, tested: Plant, result: GapResult, out: Path, dataset: Dataset, assets: Sequence[Path] = ()
) -> RepairedModel:
    """Write the effects of a result into a copy of ``model``, load it again and measure its gap with MuJoCo.

    ``tested``: of :func:`open_servo_model`.

    Raises:
        InputError: MuJoCo refuses the written model, or its error is larger than that of the repaired plant.
        SettingsError: ``out`` is the model itself.
    """
    check_other_file(model, out)
    plant, items = tested, [known_effect(row) for row in result.written]
    for item in items:
        plant = plant.with_effect(item)
    spec, compiled = load_spec(model, assets), load_mjcf(model, assets)
    native, left = write_servos(spec, compiled, plant, items, model.name)
    relocate(spec, model, out)
    write_spec(spec, out)
    inside = [item for item in left if _in_loop(item)]
    beside = {effect_key(item): item for item in (*read_side_file(model), *(item for item in left if item not in inside))}
    write_side_file(out, list(beside.values()))
    loaded = open_mujoco(out, dataset, (*assets, model.parent))
    convention = result.order.convention if result.order is not None else dataset.machine.convention
    machine = replace(tested.machine, convention=convention)
    held_out = [(recording, loaded.simulate(_as_taken(machine, recording))) for recording in split_of(dataset).held_out]
    gap = measured_gap(result.gap, run_rmse(held_out))
    if not inside:
        check_gap(gap, result.gap, out)
    reasons: dict[EffectKey, str] = {effect_key(item): NO_PLACE for item in inside}
    path = side_file(out) if beside else None
    return RepairedModel(out, path, tuple(native), tuple(left), gap, reasons)


def _as_taken(machine: Machine, recording: Recording) -> Recording:
    """A recording with its commands in the rows in which the machine takes them."""
    commands = {axis_signal(name, "command"): held_for(machine, recording, name)[0] for name in machine.axis_names}
    return replace(recording, table=recording.table.assign(**commands))


def _in_loop(item: KnownEffect) -> bool:
    return item.name in PLACES or item.side == "drive" or effect_named(item.name).stage in ("force", "links")


def write_servos(
    spec: Any, model: Any, plant: Plant, effects: Sequence[KnownEffect], source: str
) -> tuple[list[Change], list[KnownEffect]]:
    """Write effects of servo axes into ``spec``; ``model`` is compiled from it, ``plant`` has the effects.

    Returns:
        What was written, and the effects for which the model has no place.
    """
    drives, compiled = drives_of(model, plant.machine, source), compile_plant(plant)
    places, rest = dict[EffectKey, str](), list[KnownEffect]()
    for item in effects:
        place = None
        if item.name in PLACES and item.target in drives:
            i, drive = compiled.axis_index(item.target), drives[item.target]
            law = _Law(*map(float, chain.servo_law.py_func(compiled.theta, compiled.arrays.axes, i)))
            place = PLACES[item.name](Place(spec, model, plant.machine, drive, item), law)
        if place is not None:
            places[effect_key(item)] = place
            continue
        rest.append(item)
    written, left = write_inside(spec, model, plant.machine, rest, source)
    changes = {effect_key(change.effect): change for change in written}
    changes |= {effect_key(item): Change(item, places[effect_key(item)]) for item in effects if effect_key(item) in places}
    return [changes[effect_key(item)] for item in effects if effect_key(item) in changes], left


class _Law(NamedTuple):
    """Gains, limits of the force and armature of a servo, in units of its joint."""

    kp: float
    kv: float
    low: float
    high: float
    armature: float


def _gains(place: Place, law: _Law) -> str | None:
    mujoco, actuator, square = mujoco_library(), place.actuator, place.gear**2
    if int(place.model.actuator_gaintype[place.drive.actuator]) != int(mujoco.mjtGain.mjGAIN_FIXED):
        return None
    # All three, from the compiled model: in a file, a damping ratio depends on the stiffness.
    actuator.gainprm[0] = law.kp / place.drive.stiffness * float(place.model.actuator_gainprm[place.drive.actuator, 0])
    actuator.biasprm[1], actuator.biasprm[2] = -law.kp / square, -law.kv / square
    return f'actuator {place.name}: kp="{law.kp / square:.6g}" kv="{law.kv / square:.6g}"'


def _limit(place: Place, law: _Law) -> str | None:
    ends = law.low, law.high
    if not all(map(math.isfinite, ends)):
        return None
    low, high = sorted(end / place.gear for end in ends)
    place.actuator.forcerange, place.actuator.forcelimited = [low, high], mujoco_library().mjtLimited.mjLIMITED_TRUE
    if place.model.jnt_actfrclimited[place.drive.joint]:
        place.joint.actfrcrange = ends
    return f'actuator {place.name}: forcerange="{low:.6g} {high:.6g}"'


def _armature(place: Place, law: _Law) -> str | None:
    return place.with_armature(law.armature)


def _delay(place: Place, _: _Law) -> str | None:
    step, delay = float(place.model.opt.timestep), place.value("delay")
    late = round(delay / step)
    if abs(late * step - delay) < 1e-9:
        delay = (late - 1e-3) * step if late else 0.0  # a whole number of steps must not become one more by rounding
    else:
        place.actuator.interp = LINEAR
    place.actuator.delay, place.actuator.nsample = delay, max(int(place.actuator.nsample), math.ceil(delay / step) + 2)
    return f'actuator {place.name}: delay="{delay:.6g}"'


def _lag(place: Place, _: _Law) -> str | None:
    dyns, actuator = mujoco_library().mjtDyn, place.actuator
    time = place.value("time_constant")
    actuator.dyntype, actuator.dynprm[0] = dyns.mjDYN_FILTEREXACT if time > 0.0 else dyns.mjDYN_NONE, time
    return f'actuator {place.name}: dyntype="filterexact" dynprm="{time:.6g}"'


#: Effect of a controller → writer of its place; None where the model has none.
PLACES: Mapping[str, Callable[[Place, _Law], str | None]] = {
    "stiffness_error": _gains,
    "damping_error": _gains,
    "force_limit": _limit,
    "armature_error": _armature,
    "input_delay": _delay,
    "first_order_lag": _lag,
}
