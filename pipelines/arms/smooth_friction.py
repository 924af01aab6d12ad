"""Row ``smooth_friction``: single force axes whose friction is not a sharp step at zero speed.

| kind | friction |
| --- | --- |
| tanh | F·tanh(q̇/v) |
| arctan | F·(2/π)·arctan(q̇/v) |
| load | (F + μ·|load|)·sign(q̇), on a pendulum with a URDF; load: torque of the pendulum by gravity and acceleration |
| lugre | bristles (Canudas de Wit et al., IEEE TAC 40 (1995)): ż = q̇ − σ0·|q̇|/g(q̇)·z, F = σ0·z + σ1·ż |
| sharp | F·sign(q̇), as a control |

Half of the axes have viscous friction as well. The owner knows the inertia, and of the pendulum its mass.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
import pandas as pd

from arms.case import AxisText, Case, Hidden, noisy
from arms.motion import fourier
from arms.rigid import Link, RigidArm, urdf_text

Array = npt.NDArray[np.float64]

NAME = "smooth_friction"
STEP = 2e-5
#: Inertia of the rotor of a pendulum's drive [kg·m²].
ROTOR = 1e-4
#: Kinds by seed, in turn.
KINDS = ("tanh", "arctan", "load", "tanh", "lugre", "arctan", "sharp", "tanh", "load", "arctan")


@dataclass(frozen=True)
class Axis:
    """One axis. ``weight`` is the gravity torque at 90° [N·m]; the others as in the table above, in SI."""

    kind: str
    inertia: float
    weight: float
    force: float
    viscous: float
    speed: float
    load: float = 0.0
    static: float = 0.0
    bristles: float = 0.0
    bristle_damping: float = 0.0


def cases(seed: int) -> Iterator[Case]:
    yield make(seed)


def random_axis(draw: np.random.Generator, kind: str) -> Axis:
    inertia = float(draw.uniform(0.2, 0.8))
    force = float(draw.uniform(2.0, 8.0))
    viscous = float(draw.uniform(0.5, 3.0)) if draw.random() < 0.5 else 0.0
    speed = float(draw.uniform(0.03, 0.2))
    if kind == "load":
        return Axis(
            kind, inertia, float(draw.uniform(20.0, 50.0)), 0.5 * force, viscous, speed, load=float(draw.uniform(0.05, 0.15))
        )
    if kind == "lugre":
        bend = float(draw.uniform(0.002, 0.02))
        return Axis(
            kind, inertia, 0.0, force, viscous, speed, static=float(draw.uniform(0.2, 0.6)) * force,
            bristles=force / bend, bristle_damping=0.5 * math.sqrt(force / bend * inertia),
        )  # fmt: skip
    return Axis(kind, inertia, 0.0, force, viscous, speed)


def make(seed: int, kind: str | None = None, friction: bool = True) -> Case:
    """One axis; without friction the owner's model is exact."""
    draw = np.random.default_rng([seed, 6])
    axis = random_axis(draw, kind or KINDS[seed % len(KINDS)])
    if not friction:
        axis = Axis("sharp", axis.inertia, axis.weight, 0.0, 0.0, axis.speed)
    rate = float(draw.choice([500.0, 1000.0]))
    effort = 5.0 * axis.inertia + axis.weight + axis.force + 10.0
    noise_q, noise_t = float(draw.uniform(1e-5, 3e-5)), float(draw.uniform(0.003, 0.01)) * effort
    logs, clean = {}, {}
    for k in range(4):
        time = np.arange(round(draw.uniform(20.0, 30.0) * rate)) / rate
        # Slow and fast recordings: the first show the shape near zero speed, the others viscous friction.
        fastest = np.array([draw.uniform(0.2, 0.5) if k % 2 else draw.uniform(1.0, 2.0)])
        q, v, a = fourier(draw, time, np.array([-1.4]), np.array([1.4]), 0.1, 6, fastest)
        torque, angle = simulate(axis, q[:, 0], v[:, 0], a[:, 0], 1.0 / rate)
        table = pd.DataFrame({"time": time, "axis1.command": torque, "axis1.joint": angle})
        clean[f"motion-{k + 1}"] = table
        logs[f"motion-{k + 1}"] = noisy(table, {"axis1.command": noise_t, "axis1.joint": noise_q}, draw)
    return Case(
        row=NAME,
        name=f"{NAME}-{seed:03d}",
        rate_hz=rate,
        axes=[AxisText("axis1", "force", (-2.0, 2.0), "axis1_joint", inertia=ROTOR if axis.weight else axis.inertia)],
        logs=logs,
        clean=clean,
        hidden=truth(axis) if friction else [],
        noise={"axis1.joint": noise_q},
        urdf=urdf_text(pendulum(axis)) if axis.weight else None,
        extra={
            "kind": axis.kind,
            "torque_noise": {"axis1": noise_t},
            "joint_noise": noise_q,
            "inertia": {"axis1": moving_inertia(axis)},
            "rate_hz": rate,
        },
    )


def truth(axis: Axis) -> list[Hidden]:
    values: dict[str, dict[str, float]] = {
        "tanh": {"force": axis.force, "velocity": axis.speed},
        "arctan": {"force": axis.force, "velocity": axis.speed},
        "load": {"force": axis.force, "coefficient": axis.load},
        "lugre": {"force": axis.force, "static_force": axis.force + axis.static, "bristle_stiffness": axis.bristles},
        "sharp": {"force": axis.force},
    }
    name = {
        "tanh": "smooth_coulomb_friction",
        "arctan": "smooth_coulomb_friction",
        "load": "load_dependent_friction",
        "lugre": "lugre_friction",
        "sharp": "coulomb_friction",
    }[axis.kind]
    found = [Hidden(name, "axis1", values[axis.kind])]
    if axis.kind == "load":
        found.append(Hidden("coulomb_friction", "axis1", {"force": axis.force}, due=False))
    if axis.viscous:
        found.append(Hidden("viscous_friction", "axis1", {"coefficient": axis.viscous}))
    return found


def pendulum(axis: Axis) -> RigidArm:
    """A level axis with a mass at 0.5 m below it; the inertia about the axis is as given, less that of the rotor."""
    away = 0.3
    mass = axis.weight / (9.81 * away)
    own = max(axis.inertia - ROTOR - mass * away**2, 1e-3)
    return RigidArm(
        (Link("axis1", (0, 0, 0), (0, 1, 0), (-2.0, 2.0), 200.0, mass, (0.0, 0.0, -away), (own, own, own, 0.0, 0.0, 0.0)),),
        (0.0, 0.0, -0.5),
    )


def moving_inertia(axis: Axis) -> float:
    """Inertia about the axis [kg·m²]: that of the pendulum with its rotor, where there is one."""
    if not axis.weight:
        return axis.inertia
    (link,) = pendulum(axis).links
    return link.inertia[1] + link.mass * link.centre[2] ** 2 + ROTOR


# ---- Simulation ---------------------------------------------------------------------------------------------------------


def simulate(axis: Axis, q: Array, v: Array, a: Array, period: float) -> tuple[Array, Array]:
    """Torque and angle (n,) of the axis that follows a wanted motion; each row's torque is held until the next."""
    inertia = moving_inertia(axis)
    wanted = np.column_stack([q, v, a])
    kind = ("sharp", "load", "tanh", "arctan", "lugre").index(axis.kind)
    carried = inertia - ROTOR if axis.kind == "load" else 0.0
    numbers = np.array([
        inertia, axis.weight, axis.force, axis.viscous, axis.speed, axis.load, axis.static, axis.bristles, axis.bristle_damping,
        carried,
    ])  # fmt: skip
    return _run(wanted, period, round(period / STEP), kind, numbers)


@numba.njit(cache=True)
def _acceleration(net, pull, load, inertia, carried):  # type: ignore[no-untyped-def]
    """Acceleration a with inertia·a + load·|pull + carried·a| = net, for |load|·carried < inertia."""
    found = (net - load * pull) / (inertia + load * carried)
    if pull + carried * found >= 0.0:
        return found
    return (net + load * pull) / (inertia - load * carried)


@numba.njit(cache=True)
def _run(wanted, period, count, kind, numbers):  # type: ignore[no-untyped-def]
    inertia, weight, force, viscous, speed, load, static, bristles, bristle_damping, carried = numbers
    dt = period / count
    q, v, z = wanted[0, 0], wanted[0, 1], 0.0
    torque, angle = np.empty(len(wanted)), np.empty(len(wanted))
    stiff, damping = inertia * 40.0**2, inertia * 2.0 * 0.9 * 40.0
    for row in range(len(wanted)):
        applied = (
            inertia * wanted[row, 2] + weight * math.sin(q) + stiff * (wanted[row, 0] - q) + damping * (wanted[row, 1] - v)
        )
        torque[row], angle[row] = applied, q
        for _ in range(count):
            pull = weight * math.sin(q)
            net = applied - pull - viscous * v
            if kind <= 1:
                free = v + dt * net / inertia
                if abs(free) <= dt * (force + load * abs(pull)) / inertia:
                    v = 0.0
                else:
                    side = math.copysign(1.0, free)
                    moved = v + dt * _acceleration(net - side * force, pull, side * load, inertia, carried)
                    v = moved if moved * side > 0.0 else 0.0
            elif kind == 2:
                v += dt * (net - force * math.tanh(v / speed)) / inertia
            elif kind == 3:
                v += dt * (net - force * 2.0 / math.pi * math.atan(v / speed)) / inertia
            else:
                stribeck = force + static * math.exp(-((v / speed) ** 2))
                rate = v - bristles * abs(v) / stribeck * z
                # σ1 falls with speed, so that the friction stays dissipative.
                rub = bristles * z + bristle_damping * math.exp(-((v / speed) ** 2)) * rate
                z += dt * rate
                v += dt * (net - rub) / inertia
            q += dt * v
    return torque, angle
