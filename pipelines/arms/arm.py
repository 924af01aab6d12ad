"""Row ``arm``: six-axis arms in MuJoCo that track Fourier series; friction of each joint and a payload are hidden.

The owner's URDF has mass, first moment and inertia of each link off by up to 5 %. Rotor inertias are known. Friction is
applied by this file, not by MuJoCo's constraint, whose smoothing would be part of the truth: the Coulomb force of a step is
the one that stops the joint within the step, limited to ±F (time stepping of Moreau and Jean), with the joints coupled.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
import pandas as pd

from arms.case import AxisText, Case, Hidden, noisy
from arms.motion import fourier
from arms.rigid import Link, Payload, RigidArm, inverse_dynamics, mujoco_model, solid, urdf_text

Array = npt.NDArray[np.float64]

NAME = "arm"
#: Step of the simulation [s].
STEP = 5e-4
#: Largest relative error of a link's mass in the owner's URDF.
MASS_ERROR = 0.05
#: Rated torques [N·m], of the two builds.
EFFORT = {"ur": (330.0, 330.0, 150.0, 54.0, 54.0, 54.0), "anthropomorphic": (250.0, 250.0, 140.0, 50.0, 45.0, 25.0)}


@dataclass(frozen=True)
class Friction:
    """Viscous coefficients [N·m·s/rad] and Coulomb torques [N·m], each (axes,)."""

    viscous: Array
    coulomb: Array


@dataclass(frozen=True)
class Sensors:
    """Standard deviations: joint angle [rad], torque of each joint [N·m] (axes,)."""

    joint: float
    torque: Array

    def noise(self, names: list[str]) -> dict[str, float]:
        """Signal → standard deviation, axis by axis."""
        parts = ({f"{name}.joint": self.joint, f"{name}.command": float(t)} for name, t in zip(names, self.torque, strict=True))
        return {signal: level for part in parts for signal, level in part.items()}


def cases(seed: int) -> Iterator[Case]:
    """The arm with this seed; odd seeds carry a payload."""
    yield make(seed, friction=True, payload=seed % 2 == 1)


def make(seed: int, friction: bool = True, payload: bool = False, mass_error: float = MASS_ERROR) -> Case:
    """One arm. Without friction, payload and mass errors the owner's model is exact."""
    draw = np.random.default_rng([seed, 1])
    owner = random_arm(draw, "ur" if (seed // 2) % 2 == 0 else "anthropomorphic")
    effort = np.array([link.effort for link in owner.links])
    rubbing = random_friction(draw, effort) if friction else Friction(np.zeros(6), np.zeros(6))
    factors = 1.0 + draw.uniform(-mass_error, mass_error, 6)
    carried = random_payload(draw)
    real = with_masses(replace(owner, payload=carried if payload else None), factors)
    sensors = Sensors(float(draw.uniform(1e-5, 5e-5)), draw.uniform(0.003, 0.01) * effort)
    rate = float(draw.choice([250.0, 500.0]))
    logs, clean = {}, {}
    for k in range(int(draw.integers(3, 6))):
        table = record(owner, real, rubbing, draw, rate, float(draw.uniform(20.0, 30.0)))
        clean[f"motion-{k + 1}"] = table
        logs[f"motion-{k + 1}"] = noisy(table, sensors.noise(owner.names), draw)
    hidden = []
    spread = payload_spread(owner, carried, sensors, mass_error, list(clean.values())) if payload else None
    for k, name in enumerate(owner.names):
        if rubbing.viscous[k] > 0.0:
            hidden.append(Hidden("viscous_friction", name, {"coefficient": float(rubbing.viscous[k])}))
        if rubbing.coulomb[k] > 0.0:
            hidden.append(Hidden("coulomb_friction", name, {"force": float(rubbing.coulomb[k])}))
    if payload:
        hidden.append(Hidden("payload", "tool", {"mass": carried.mass, "centre": list(carried.centre)}))
    if mass_error:
        hidden += [
            Hidden("link_inertia", name, {"ratio": float(factor)}, due=False)
            for name, factor in zip(owner.names, factors, strict=True)
        ]
    return Case(
        row=NAME,
        name=f"{NAME}-{seed:03d}",
        rate_hz=rate,
        axes=[AxisText(link.name, "force", joint=f"{link.name}_joint", inertia=link.armature) for link in owner.links],
        logs=logs,
        clean=clean,
        hidden=hidden,
        noise={f"{name}.joint": sensors.joint for name in owner.names},
        urdf=urdf_text(owner),
        extra={
            "torque_noise": dict(zip(owner.names, sensors.torque.tolist(), strict=True)),
            "joint_noise": sensors.joint,
            "inertia": dict(zip(owner.names, inertial_gain(real, list(clean.values())).tolist(), strict=True)),
            "rate_hz": rate,
            "payload_spread": spread,
        },
    )


def random_arm(draw: np.random.Generator, build: str) -> RigidArm:
    """Proportions of a collaborative arm (axes z y y y z y) or of an anthropomorphic one (z y y x y x)."""
    upper, fore = draw.uniform(0.35, 0.65), draw.uniform(0.3, 0.6)
    side, wrist = draw.uniform(0.1, 0.18), draw.uniform(0.08, 0.13)
    masses = [draw.uniform(4.0, 9.0), draw.uniform(6.0, 12.0), draw.uniform(2.5, 6.0), *draw.uniform(1.0, 2.5, 3)]
    bend = float(draw.uniform(-0.02, 0.02))
    rows: list[tuple[tuple[float, float, float], tuple[int, int, int], tuple[float, float, float], tuple[float, float, float]]]
    if build == "ur":
        # Origin of the joint, its axis, centre of mass, size of the box.
        rows = [
            ((0, 0, draw.uniform(0.1, 0.2)), (0, 0, 1), (0, 0.02, -0.02), (0.15, 0.15, 0.18)),
            ((0, side, 0), (0, 1, 0), (0, 0.02, 0.45 * upper), (0.12, 0.12, upper)),
            ((0, -0.9 * side, upper), (0, 1, 0), (0, bend, 0.45 * fore), (0.1, 0.1, fore)),
            ((0, 0, fore), (0, 1, 0), (0, 0.7 * wrist, 0.01), (0.09, 0.12, 0.09)),
            ((0, wrist, 0), (0, 0, 1), (0, 0.01, 0.6 * wrist), (0.09, 0.09, 0.12)),
            ((0, 0, wrist), (0, 1, 0), (0.005, 0.5 * wrist, 0), (0.08, 0.08, 0.06)),
        ]
        tip = (0.0, draw.uniform(0.08, 0.15), 0.0)
        wide = (2.4, 1.2, 1.9, 2.0, 2.2, 2.6)
    else:
        rows = [
            ((0, 0, draw.uniform(0.15, 0.25)), (0, 0, 1), (0.03, 0.02, 0.05), (0.2, 0.2, 0.2)),
            ((draw.uniform(0.02, 0.1), 0, 0.15), (0, 1, 0), (0.01, bend, 0.45 * upper), (0.14, 0.12, upper)),
            ((0, 0, upper), (0, 1, 0), (0.05, 0.01, 0.05), (0.18, 0.14, 0.14)),
            ((0.1, 0, 0.06), (1, 0, 0), (0.5 * fore, 0.01, 0), (fore, 0.1, 0.1)),
            ((fore, 0, 0), (0, 1, 0), (0.4 * wrist, 0, 0.005), (0.1, 0.08, 0.08)),
            ((wrist, 0, 0), (1, 0, 0), (0.02, 0.005, 0.004), (0.05, 0.08, 0.08)),
        ]
        tip = (draw.uniform(0.08, 0.15), 0.0, 0.02)
        wide = (2.5, 1.1, 1.4, 2.6, 1.8, 2.8)
    links = []
    for k, (origin, axis, centre, size) in enumerate(rows):
        effort = EFFORT[build][k]
        off = draw.normal(0.0, 0.008, 3)
        x, y, z = (float(value) for value in np.add(centre, off))
        links.append(
            Link(
                name=f"j{k + 1}",
                origin=(float(origin[0]), float(origin[1]), float(origin[2])),
                axis=axis,
                limits=(-wide[k], wide[k]),
                effort=effort,
                mass=float(masses[k]),
                centre=(x, y, z),
                inertia=solid(float(masses[k]), size, draw),  # type: ignore[arg-type]
                armature=float(draw.uniform(1.0, 3.0) * 1e-3 * effort),
            )
        )
    return RigidArm(tuple(links), tip)


def random_friction(draw: np.random.Generator, effort: Array) -> Friction:
    """Harmonic and belt drives: a few percent of the rated torque; one joint in five has no Coulomb friction."""
    viscous = draw.uniform(0.02, 0.08, len(effort)) * effort
    coulomb = draw.uniform(0.02, 0.07, len(effort)) * effort
    without = draw.random(len(effort)) < 0.2
    return Friction(viscous, np.where(without, 0.0, coulomb))


def random_payload(draw: np.random.Generator) -> Payload:
    mass = float(math.exp(draw.uniform(math.log(0.5), math.log(5.0))))
    x, y, z = (float(value) for value in draw.uniform(-0.05, 0.05, 3))
    return Payload(mass, (x, y, z), 0.4 * mass * 0.04**2)


def with_masses(arm: RigidArm, factors: Array) -> RigidArm:
    """The arm with mass, and with it first moment and inertia, of each link times its factor."""
    links = [
        replace(link, mass=link.mass * f, inertia=tuple(f * value for value in link.inertia))  # type: ignore[arg-type]
        for link, f in zip(arm.links, factors, strict=True)
    ]
    return replace(arm, links=tuple(links))


def payload_spread(
    arm: RigidArm, payload: Payload, sensors: Sensors, mass_error: float, logs: list[pd.DataFrame], every: int = 50
) -> float:
    """Standard deviation of the payload's mass [kg] that remains where the links' masses are known to ``mass_error``.

    The linear Gaussian posterior (Bayes) of payload mass and first moment beside a scale of each link, friction known. Mass
    errors of the last links and a payload load the same joints, so that this is larger than the torque noise alone gives.
    """
    count = len(arm.links)
    rows = []
    for table in logs:
        q = table[[f"{name}.joint" for name in arm.names]].to_numpy()
        step = float(table["time"][1])
        v = np.gradient(q, step, axis=0)
        chosen = (q[10:-10:every], v[10:-10:every], np.gradient(v, step, axis=0)[10:-10:every])
        nominal = inverse_dynamics(arm, *chosen)
        columns = []
        for k in range(count):
            factors = np.ones(count)
            factors[k] = 2.0
            columns.append(inverse_dynamics(with_masses(arm, factors), *chosen) - nominal)
        point = inverse_dynamics(replace(arm, payload=Payload(1.0, (0.0, 0.0, 0.0), 1e-9)), *chosen) - nominal
        columns.append(point)
        for axis in np.eye(3):
            x, y, z = (float(value) for value in 0.01 * axis)
            moved = inverse_dynamics(replace(arm, payload=Payload(1.0, (x, y, z), 1e-9)), *chosen) - nominal
            # Small offset: the second moment of the point mass is negligible.
            columns.append((moved - point) / 0.01)
        rows.append(np.stack(columns, axis=-1))
    # All rows of the log, of which every n-th is taken here.
    jacobian = np.concatenate(rows) * math.sqrt(every) / sensors.torque[None, :, None]
    flat = jacobian.reshape(-1, count + 4)
    precision = flat.T @ flat
    precision[range(count), range(count)] += 3.0 / max(mass_error, 1e-6) ** 2  # of a uniform distribution
    return float(np.sqrt(np.linalg.inv(precision)[count, count]))


def inertial_gain(arm: RigidArm, logs: list[pd.DataFrame], every: int = 500) -> Array:
    """Torque noise of each axis per unit of independent acceleration noise on all axes [kg·m²], (axes,).

    Root of the sum over its row of the mass matrix, mean square over the recorded postures.
    """
    import mujoco

    model, data = mujoco_model(arm)
    mass = np.empty((len(arm.links), len(arm.links)))
    found = []
    for table in logs:
        for q in table[[f"{name}.joint" for name in arm.names]].to_numpy()[::every]:
            data.qpos[:] = q
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, mass)
            found.append((mass**2).sum(axis=1))
    return np.asarray(np.sqrt(np.mean(found, axis=0)))


# ---- Simulation ---------------------------------------------------------------------------------------------------------


def record(
    owner: RigidArm, real: RigidArm, friction: Friction, draw: np.random.Generator, rate: float, seconds: float
) -> pd.DataFrame:
    """One recording without noise: ``time``, ``<axis>.command`` [N·m], ``<axis>.joint`` [rad].

    The controller knows the owner's model: feed-forward torque along the wanted motion, and proportional and derivative
    feedback.
    """
    time = np.arange(round(seconds / STEP)) * STEP
    low, high = owner.limits.T
    effort = np.array([link.effort for link in owner.links])
    fastest = np.where(effort > 100.0, 1.2, 2.0) * draw.uniform(0.6, 1.2)
    base = float(draw.uniform(0.06, 0.12))
    wanted = fourier(draw, time, low, high, base, int(draw.integers(4, 8)), fastest)
    every = 10
    forward = inverse_dynamics(owner, *(part[::every] for part in wanted))
    feed = np.column_stack([np.interp(time, time[::every], column) for column in forward.T])
    q, torque = simulate(real, friction, *wanted[:2], feed, effort)
    taken = slice(0, None, round(1.0 / (rate * STEP)))
    table: dict[str, Any] = {"time": time[taken]}
    for k, name in enumerate(owner.names):
        table[f"{name}.command"] = torque[taken, k]
    for k, name in enumerate(owner.names):
        table[f"{name}.joint"] = q[taken, k]
    return pd.DataFrame(table)


def simulate(arm: RigidArm, friction: Friction, wanted: Array, speed: Array, feed: Array, effort: Array) -> tuple[Array, Array]:
    """Joint angles and applied torques, each (n, axes), on the grid of the simulation."""
    import mujoco

    model, data = mujoco_model(arm, STEP)
    count = len(arm.links)
    data.qpos[:], data.qvel[:] = wanted[0], speed[0]
    q, torque = np.empty_like(wanted), np.empty_like(wanted)
    stiff, damping = 12.0 * effort, 1.2 * effort
    inverse = np.empty((count, count))
    rub = np.zeros(count)
    one = np.eye(count)
    for k in range(len(wanted)):
        q[k] = data.qpos
        drive = feed[k] + stiff * (wanted[k] - data.qpos) + damping * (speed[k] - data.qvel)
        np.clip(drive, -effort, effort, out=drive)
        torque[k] = drive
        data.qfrc_applied[:] = drive - friction.viscous * data.qvel
        mujoco.mj_forward(model, data)
        mujoco.mj_solveM(model, data, inverse, one)
        coulomb_step(inverse, data.qvel + STEP * data.qacc, friction.coulomb, rub)
        data.qvel += STEP * (data.qacc - inverse @ rub)
        data.qpos += STEP * data.qvel
    return q, torque


@numba.njit(cache=True)
def coulomb_step(inverse: Array, free: Array, limit: Array, force: Array) -> None:
    """Coulomb torques (axes,) that stop the joints in one step, each within ±limit: projected Gauss-Seidel.

    Args:
        inverse: inverse mass matrix; ``free``: speeds after the step without Coulomb friction [rad/s].
        force: torques of the step before as a start; overwritten.
    """
    for _ in range(30):
        change = 0.0
        for i in range(len(free)):
            speed = free[i]
            for j in range(len(free)):
                speed -= STEP * inverse[i, j] * force[j]
            new = force[i] + speed / (STEP * inverse[i, i])
            new = min(max(new, -limit[i]), limit[i])
            change = max(change, abs(new - force[i]))
            force[i] = new
        if change < 1e-9:
            break
