"""A small machine with one axis of every kind, and recordings that excite it, for the checks of effects."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.effects import Effect
from sysid.machine import KnownEffect, Machine, machine_from_files
from sysid.plant import Model, Plant, compile_plant, nominal_plant
from sysid.plant.link_torque import force_constants, static_torque
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]
Values = Mapping[str, float | list[float]]
#: Parameters (None: without the effect) and a recording → the output of the effect's stage, (n, d).
Run = Callable[[Values | None, Recording], Array]

RATE_HZ = 100.0
_URDF = """<robot name="probe">
  <link name="base"/><link name="column"/><link name="arm"/><link name="slide"/><link name="hand"/><link name="tip"/>
  <link name="tool"/>
  <joint name="slew_joint" type="revolute"><parent link="base"/><child link="column"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 0 1"/><limit lower="-1000" upper="1000"/></joint>
  <joint name="boom_joint" type="revolute"><parent link="column"/><child link="arm"/>
    <origin xyz="0.05 0 0"/><axis xyz="0 -1 0"/><limit lower="-0.5" upper="1.2"/></joint>
  <joint name="slide_joint" type="prismatic"><parent link="arm"/><child link="slide"/>
    <origin xyz="0.6 0 0"/><axis xyz="1 0 0"/><limit lower="-1e9" upper="1e9"/></joint>
  <joint name="wrist_joint" type="revolute"><parent link="slide"/><child link="hand"/>
    <origin xyz="0.3 0 0"/><axis xyz="0 -1 0"/><limit lower="-3" upper="3"/></joint>
  <joint name="grip" type="fixed"><parent link="hand"/><child link="tip"/><origin xyz="0.2 0 0.02"/></joint>
  <joint name="hang" type="fixed"><parent link="tip"/><child link="tool"/><origin xyz="0 0 0"/></joint>
</robot>
"""

_MACHINE = """
schema = 1
name = "probe"
rate_hz = 100.0
urdf = "probe.urdf"
tip = "tip"
tool = "tool"
[[axes]]
name = "slew"
joint = "slew_joint"
actuation = "velocity"
drives = "joint"
gain = 0.5
[[axes]]
name = "boom"
joint = "boom_joint"
actuation = "velocity"
drives = "cylinder"
gain = 0.008
stroke = [0.0, 0.11]
linkage = {kind = "triangle", a = 0.12, b = 0.20, offset = 0.9, retracted = 0.15, sense = 1}
[[axes]]
name = "slide"
joint = "slide_joint"
actuation = "force"
drives = "joint"
inertia = 2.0
[[axes]]
name = "wrist"
joint = "wrist_joint"
actuation = "position"
drives = "joint"
"""

_ARM_URDF = """<robot name="probe_arm">
  <link name="base"/><link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="4"/>
    <inertia ixx="0.01" iyy="0.06" izz="0.06" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0.15 0.02 0"/><mass value="2"/>
    <inertia ixx="0.005" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="hand"/>
  <joint name="lift_joint" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 -1 0"/><limit lower="-2" upper="2"/></joint>
  <joint name="elbow_joint" type="revolute"><parent link="upper"/><child link="fore"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 -1 0"/><limit lower="-2" upper="2"/></joint>
  <joint name="grip" type="fixed"><parent link="fore"/><child link="hand"/><origin xyz="0.3 0 0"/></joint>
</robot>
"""

_ARM = """
schema = 1
name = "probe_arm"
rate_hz = 100.0
urdf = "probe_arm.urdf"
tip = "hand"
[[axes]]
name = "lift"
joint = "lift_joint"
actuation = "force"
drives = "joint"
[[axes]]
name = "elbow"
joint = "elbow_joint"
actuation = "force"
drives = "joint"
"""

_SERVO = """
schema = 1
name = "probe_servo"
rate_hz = 100.0
[[axes]]
name = "turn"
joint_type = "revolute"
actuation = "servo"
drives = "joint"
inertia = 0.05
servo = { kp = 20.0, kv = 1.2, force_limit = 8.0 }
"""

#: Largest command of each axis in the probe's inputs; newtons for the slide, radians for the wrist.
AMPLITUDES = {"slew": 1.0, "boom": 1.0, "slide": 4.0, "wrist": 1.0}


@dataclass(frozen=True)
class EffectPlace:
    """A location of an effect in the probe machine.

    Args:
        stage: with the evaluated output: ``drive``, ``joint``, ``tip`` or ``tool``; ``links``: torques at rest of an arm with
            masses; ``friction``: forces of that arm in slow motion.
        inputs: the signals that drive this stage.
    """

    target: str
    side: str | None
    stage: str
    inputs: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.target}{f', {self.side}' if self.side else ''} ({self.stage})"


@functools.cache
def probe_machine() -> Machine:
    """Velocity axes that drive a joint (slew) and a cylinder (boom), a force axis (slide), a position axis (wrist), a tool."""
    return machine_from_files({"machine.toml": _MACHINE, "probe.urdf": _URDF}, "probe")


@functools.cache
def probe_arm() -> Machine:
    """Two force axes in a vertical plane that move links with masses."""
    return machine_from_files({"machine.toml": _ARM, "probe_arm.urdf": _ARM_URDF}, "probe_arm")


@functools.cache
def probe_servo() -> Machine:
    """One servo axis that turns about a vertical axis."""
    return machine_from_files({"machine.toml": _SERVO}, "probe_servo")


def probe_recording(seconds: float = 6.0, seed: int = 0) -> Recording:
    """Half a second of rest, then steps and sines at every input."""
    rng = np.random.default_rng(seed)
    count = round(seconds * RATE_HZ)
    time = np.arange(count) / RATE_HZ
    machine = probe_machine()
    columns: dict[str, Array] = {"time": time}
    moving = np.arange(count) >= min(50, count // 4)
    for name, amplitude in AMPLITUDES.items():
        levels = rng.uniform(-1.0, 1.0, count // 40 + 1).repeat(40)[:count]
        wave = np.sin(2 * np.pi * rng.uniform(0.3, 0.9) * time + rng.uniform(0, 6.28))
        columns[axis_signal(name, "command")] = np.where(moving, amplitude * np.clip(0.6 * levels + 0.6 * wave, -1, 1), 0.0)
    columns["boom.cylinder"] = 0.055 + 0.04 * _path(time, moving, rng)
    joints = {"slew": 1.2, "boom": 0.4, "slide": 0.2, "wrist": 0.8}
    columns |= {axis_signal(name, "joint"): size * _path(time, moving, rng) for name, size in joints.items()}
    joint_values = np.column_stack([columns[axis_signal(name, "joint")] for name in machine.axis_names])
    kinematics = machine.kinematics()
    assert kinematics is not None
    tip = kinematics.tip_position(joint_values)
    columns |= {signal: tip[:, k] for k, signal in enumerate(point_signals("ee"))}
    columns |= {signal: np.full(count, np.nan) for signal in point_signals("tool")}
    columns |= {axis_signal(name, "joint"): _path(time, moving, rng) for name in probe_arm().axis_names}
    for name in probe_servo().axis_names:
        levels = rng.uniform(-1.0, 1.0, count // 40 + 1).repeat(40)[:count]
        columns[axis_signal(name, "command")] = np.where(moving, 0.5 * levels + 0.5 * _path(time, moving, rng), 0.0)
    return Recording("probe", pd.DataFrame(columns), RATE_HZ)


def _path(time: Array, moving: npt.NDArray[np.bool_], rng: np.random.Generator) -> Array:
    """A smooth path in [−1, 1] that begins at rest at zero."""
    begin = float(time[np.argmax(moving)])
    t = np.where(moving, time - begin, 0.0)
    total = sum(np.sin(2 * np.pi * f * rng.uniform(0.8, 1.2) * t) * rng.choice([-1.0, 1.0]) for f in (0.25, 0.6, 1.1))
    return np.asarray(total / 3.0)


def with_inputs(recording: Recording, inputs: Sequence[str], values: Array) -> Recording:
    """The recording with ``values`` (n, len(inputs)) as these inputs; its length becomes n."""
    count = len(values)
    rows = np.minimum(np.arange(count), len(recording) - 1)
    table = recording.table.iloc[rows].reset_index(drop=True)
    table["time"] = np.arange(count) / recording.rate_hz
    return replace(recording, table=table.assign(**{name: values[:, k] for k, name in enumerate(inputs)}))


def places_of(effect: Effect) -> tuple[EffectPlace, ...]:
    """Every kind of location of the effect on the probe machine."""
    machine = probe_machine()
    joints = tuple(axis_signal(name, "joint") for name in machine.axis_names)
    if effect.of_links:
        inputs = tuple(axis_signal(name, "joint") for name in probe_arm().axis_names)
        targets = probe_arm().axis_names if effect.target == "axis" else (effect.target,)
        return tuple(
            EffectPlace(target, None, "links" if effect.stage == "links" else "friction", inputs) for target in targets
        )
    if effect.target == "tool":
        return (EffectPlace("tool", None, "tool", point_signals("ee")),)
    if effect.target in ("base", "ee"):
        return (EffectPlace(effect.target, None, "tip", joints),)
    if effect.target == "machine":
        return (EffectPlace("machine", None, "drive", tuple(axis_signal(a.name, "command") for a in machine.axes[:2])),)
    if effect.target == "signal":
        return (
            EffectPlace("boom.joint", None, "joint", ("boom.cylinder",)),
            EffectPlace("tool.x", None, "tool", point_signals("ee")),
        )
    if effect.target == "stream":
        return (
            EffectPlace("capture", None, "joint", ("boom.cylinder",)),
            EffectPlace("capture", None, "tool", point_signals("ee")),
        )
    found = []
    loaded = any(parameter.scale == "1/load" for form in effect.forms for parameter in form.parameters)
    for axis in machine.axes:
        if axis.actuation not in effect.actuations or (loaded and axis.name == "slew"):  # no gravity load on a vertical axis
            continue
        command = (axis_signal(axis.name, "command"),)
        if effect.stage in ("command", "force"):
            found.append(EffectPlace(axis.name, None, "drive", command))
        elif effect.stage == "end_effector":
            found.append(EffectPlace(axis.name, None, "tip", joints))
        for side in effect.sides:
            if side == "structure":
                found.append(EffectPlace(axis.name, side, "tip", joints))
            elif axis.drives == "joint":
                found.append(EffectPlace(axis.name, side, "drive", command))
            else:
                found.append(EffectPlace(axis.name, side, "joint", (axis_signal(axis.name, "cylinder"),)))
    if "servo" in effect.actuations and (effect.stage in ("command", "force") or effect.sides):
        on_drive = next(iter(effect.sides), None)
        found += [EffectPlace(name, on_drive, "drive", (axis_signal(name, "command"),)) for name in probe_servo().axis_names]
    return tuple(found)


@functools.cache
def _nominal() -> tuple[Plant, Model]:
    plant = nominal_plant(probe_machine(), streams={"capture": ("boom.joint", *point_signals("tool"))})
    return plant, compile_plant(plant)


@functools.cache
def _nominal_arm() -> tuple[Plant, Model]:
    plant = nominal_plant(probe_arm())
    return plant, compile_plant(plant)


@functools.cache
def _nominal_servo() -> tuple[Plant, Model]:
    plant = nominal_plant(probe_servo())
    return plant, compile_plant(plant)


def plant_run(effect: Effect, place: EffectPlace) -> Run:
    """The compiled plant with only the effect at ``place``."""
    servo = place.target in probe_servo().axis_names
    plant, model = _nominal_servo() if servo else _nominal_arm() if effect.of_links else _nominal()

    def run(values: Values | None, recording: Recording) -> Array:
        at = plant
        if values is not None:
            side = place.side
            at = plant.with_effect(KnownEffect(effect.name, place.target, dict(values), side))  # type: ignore[arg-type]
        theta = at.vector()[None]
        if place.stage == "links":
            joints = np.column_stack([recording.values(name) for name in place.inputs])
            return static_torque(model, theta[0], joints)
        if place.stage == "friction":
            return _slow_force(model, theta[0], recording, place)
        if place.stage == "drive":
            axis = "slew" if place.target == "machine" else place.target
            return np.asarray(model.drive(theta, _starting(recording, model.machine.axis(axis).driven), axis).T)
        if place.stage == "joint":
            axis = "boom" if place.target in ("boom.joint", "capture") else place.target
            return np.asarray(model.joint(theta, _straight(recording, model, axis), axis).T)
        return np.asarray((model.tip if place.stage == "tip" else model.tool)(theta, recording)[0])

    return run


def _slow_force(model: Model, theta: Array, recording: Recording, place: EffectPlace) -> Array:
    """Force of an axis of the arm without inertial forces, at the speed since the last sample, (n, 1); gaps are rest."""
    joints = recording.table[list(place.inputs)].ffill().to_numpy()
    i, dt = model.axis_index(place.target), 1.0 / recording.rate_hz
    position, carried = joints[:, i].copy(), static_torque(model, theta, joints)[:, i].copy()
    speed = np.diff(position, prepend=position[:1]) / dt
    friction = model.inverse(theta, place.target, position, speed, np.zeros_like(speed), dt, carried)
    return np.asarray(friction + carried / force_constants(model, theta)[i])[:, None]


def _straight(recording: Recording, model: Model, axis: str) -> Recording:
    """The recording with the joint computed by its linkage: backlash starts in its middle, and the gravity load is known."""
    signal, nominal = axis_signal(axis, "joint"), model.theta[None]
    unknown = replace(recording, table=recording.table.assign(**{signal: np.nan}))
    return replace(recording, table=recording.table.assign(**{signal: model.joint(nominal, unknown, axis)[0]}))


def _starting(recording: Recording, signal: str) -> Recording:
    """The recording with the driven signal known only at the first sample, which sets the initial position."""
    values = np.full(len(recording), np.nan)
    first = recording.values(signal)
    values[:1] = first[0] if len(first) and np.isfinite(first[0]) else 0.0
    return replace(recording, table=recording.table.assign(**{signal: values}))
