"""Servo arms that sag under gravity, simulated without the plant: dead time, lag, spring, encoder.

An axis about the vertical and two pitch axes in one plane. The joints, which the encoders measure, are those of the setpoints
less compliance times gravity moment.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Dataset, Recording
from sysid.machine import machine_from_files

Array = npt.NDArray[np.float64]

AXES = ("yaw", "shoulder", "elbow")
RATE_HZ, GRAVITY, NOISE = 50.0, 9.80665, 3e-4
LENGTH, MASS = (0.15, 0.12), (0.3, 0.2)
DELAY, LAG = 0.04, 0.06


@dataclass(frozen=True)
class Servos:
    """``compliance`` [rad/(N·m)] and ``bias`` of the encoder [rad] by axis."""

    compliance: dict[str, float] = field(default_factory=dict)
    bias: dict[str, float] = field(default_factory=dict)


def urdf(masses: bool = True) -> str:
    """The arm; positive pitch lifts the links."""
    parts = ['<robot name="arm"><link name="base"/>']
    parents = ("base", "yaw_link", "shoulder_link")
    at = ("0 0 0.1", "0 0 0.02", f"{LENGTH[0]} 0 0")
    for name, parent, origin, axis in zip(AXES, parents, at, ("0 0 1", "0 -1 0", "0 -1 0"), strict=True):
        k = AXES.index(name) - 1
        body = f'<inertial><origin xyz="{LENGTH[k] / 2} 0 0"/><mass value="{MASS[k]}"/></inertial>' if masses and k >= 0 else ""
        parts.append(f'<link name="{name}_link">{body}</link>')
        parts.append(
            f'<joint name="{name}_joint" type="revolute"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<origin xyz="{origin}"/><axis xyz="{axis}"/><limit lower="-2" upper="2" effort="1" velocity="9"/></joint>'
        )
    parts.append(
        '<link name="tip"/><joint name="tip_joint" type="fixed"><parent link="elbow_link"/><child link="tip"/>'
        f'<origin xyz="{LENGTH[1]} 0 0"/></joint></robot>'
    )
    return "".join(parts)


def machine_files(masses: bool | None = True) -> dict[str, str]:
    """Description of the machine: with masses, without them (False), or without a URDF (None)."""
    head = f'schema = 1\nname = "servos"\nrate_hz = {RATE_HZ}\nconvention = "written_before_read"\n'
    head += "" if masses is None else 'urdf = "arm.urdf"\ntip = "tip"\n'
    axes = ""
    for name in AXES:
        where = "limits = [-2.0, 2.0]" if masses is None else f'joint = "{name}_joint"'
        axes += f'[[axes]]\nname = "{name}"\nactuation = "position"\ndrives = "joint"\n{where}\n'
    noise = "[noise]\n" + "".join(f'"{name}.joint" = {NOISE}\n' for name in AXES)
    return {"machine.toml": head + axes + noise} | ({} if masses is None else {"arm.urdf": urdf(masses)})


def gravity_moments(q: Array) -> Array:
    """Gravity moments at joints (n, 3) [N·m], (n, 3); positive where they oppose positive motion."""
    first, second = np.cos(q[:, 1]), np.cos(q[:, 1] + q[:, 2])
    elbow = MASS[1] * GRAVITY * 0.5 * LENGTH[1] * second
    shoulder = elbow + GRAVITY * LENGTH[0] * (0.5 * MASS[0] + MASS[1]) * first
    return np.column_stack([np.zeros(len(q)), shoulder, elbow])


def recording(servos: Servos, name: str, seed: int, seconds: float = 40.0) -> Recording:
    """Moves of all axes between random postures, each with a hold of 1 to 2 s."""
    draw = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    setpoint = np.column_stack([_moves(draw, time) for _ in AXES])
    late = np.column_stack([np.interp(time - DELAY, time, u) for u in setpoint.T])
    keep = np.exp(-1.0 / (RATE_HZ * LAG))
    reference = late.copy()
    for k in range(1, len(late)):
        reference[k] = late[k] + keep * (reference[k - 1] - late[k])
    compliance = np.array([servos.compliance.get(axis, 0.0) for axis in AXES])
    q = reference.copy()
    for _ in range(30):
        q = reference - compliance * gravity_moments(q)
    table = {"time": time}
    for k, axis in enumerate(AXES):
        table[f"{axis}.command"] = setpoint[:, k]
        table[f"{axis}.joint"] = q[:, k] + servos.bias.get(axis, 0.0) + draw.normal(0.0, NOISE, len(time))
    return Recording(name, pd.DataFrame(table), RATE_HZ)


def _moves(draw: np.random.Generator, time: Array) -> Array:
    at, place = 0.0, float(draw.uniform(-1.0, 1.0))
    knots, places = [at], [place]
    while at < time[-1]:
        at += draw.uniform(1.0, 2.0)
        knots.append(at)
        places.append(place)
        place = float(draw.uniform(-1.0, 1.0))
        at += abs(place - places[-1]) / draw.uniform(1.0, 2.5)
        knots.append(at)
        places.append(place)
    return np.interp(time, knots, places)


def servo_dataset(servos: Servos, masses: bool | None, axes: tuple[str, ...] = AXES) -> Dataset:
    """Three recordings, one for each role."""
    machine = machine_from_files(machine_files(masses), "servos")
    parts = [recording(servos, f"take-{k}", 10 + k) for k in range(3)]
    roles = dict(zip((part.name for part in parts), ("fit", "select", "held_out"), strict=True))
    return Dataset.of(machine, parts, roles)
