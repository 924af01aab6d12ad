"""Row ``servo_sag``: hobby servos that sag under gravity, each log with a description without masses and one with them.

Setpoint → dead time → first-order lag → proportional controller of finite stiffness with damping. Under a load the joint,
which the encoder measures, stays behind the setpoint by load over stiffness.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from arms.case import AxisText, Case, Hidden, noisy
from arms.motion import fourier, moves
from arms.rigid import Link, RigidArm, mujoco_model, solid, urdf_text

Array = npt.NDArray[np.float64]

NAME = "servo_sag"
STEP, RATE = 1e-3, 100.0
#: Sag at the largest load from which the compliance is to be named [rad]; the encoders' noise is at most a seventeenth.
SAG_DUE = np.radians(0.5)


def cases(seed: int) -> Iterator[Case]:
    """The same recordings twice: ``plain`` without a URDF, ``urdf`` with masses."""
    yield from make(seed)


def make(seed: int, sags: bool = True) -> tuple[Case, Case]:
    """One servo arm. Without sag the servos are 200 times as stiff."""
    draw = np.random.default_rng([seed, 2])
    arm = random_arm(draw, int(draw.integers(3, 7)))
    names, count = arm.names, len(arm.links)
    largest = largest_load(arm, draw)
    # One make of servo: the most loaded joint sags by 2° to 5°, the others by their load.
    soft = np.radians(draw.uniform(2.0, 5.0)) / largest.max()
    compliance = (1.0 if sags else 0.005) * soft * draw.uniform(0.7, 1.3, count)
    delay = draw.integers(5, 40, count) * STEP
    lag = draw.uniform(0.03, 0.12, count)
    noise = float(draw.uniform(1e-4, 5e-4))
    encoders = {f"{name}.joint": noise for name in names}
    logs, clean = {}, {}
    for k in range(4):
        table = record(arm, compliance, delay, lag, draw, float(draw.uniform(40.0, 60.0)), smooth=k == 1)
        clean[f"motion-{k + 1}"] = table
        logs[f"motion-{k + 1}"] = noisy(table, encoders, draw)
    # Delay, lag and damping together are a servo of third order: any form of them is right, and none is due.
    servo = [Hidden(kind, name, due=False) for kind in ("servo_lag", "input_delay") for name in names]

    def case(variant: str) -> Case:
        with_masses = variant == "urdf"
        gives = [
            Hidden("joint_compliance", name, {"compliance": float(c)}, due=with_masses and bool(c * load > SAG_DUE))
            for name, c, load in zip(names, compliance, largest, strict=True)
            if sags
        ]
        return Case(
            row=NAME,
            name=f"{NAME}-{seed:03d}-{variant}",
            rate_hz=RATE,
            axes=[AxisText(link.name, "position", link.limits, f"{link.name}_joint") for link in arm.links],
            logs=logs,
            clean=clean,
            hidden=servo + gives,
            noise=encoders,
            urdf=urdf_text(arm) if with_masses else None,
            extra={
                "variant": variant,
                "sagging": [n for n, c, m in zip(names, compliance, largest, strict=True) if sags and c * m > SAG_DUE],
                "largest_load": dict(zip(names, largest.tolist(), strict=True)),
            },
        )

    return case("plain"), case("urdf")


def random_arm(draw: np.random.Generator, joints: int) -> RigidArm:
    """A hobby arm: yaw, pitch joints, and a roll of the wrist where there are five or more."""
    axes = [(0, 0, 1), *[(0, 1, 0)] * min(joints - 1, 3), (1, 0, 0), (0, 1, 0)][:joints]
    names = ["yaw", "shoulder", "elbow", "wrist", "roll", "hand"][:joints]
    wide = (1.5, 0.9, 1.2, 1.3, 1.5, 1.0)
    links = []
    reach = 0.0
    for k, (name, axis) in enumerate(zip(names, axes, strict=True)):
        length = float(draw.uniform(0.08, 0.16)) if k else 0.05
        mass = float(draw.uniform(0.08, 0.25))
        at = (0.0, 0.0, 0.05) if k < 2 else (reach, 0.0, 0.0)
        centre = (0.0, 0.0, 0.02) if not k else (float(draw.uniform(0.4, 0.6)) * length, 0.0, float(draw.uniform(-0.01, 0.01)))
        inertia = solid(mass, (length, 0.04, 0.04))
        links.append(Link(name, at, axis, (-wide[k], wide[k]), 3.0, mass, centre, inertia, armature=0.006))  # type: ignore[arg-type]
        reach = length
    return RigidArm(tuple(links), (reach, 0.0, 0.0))


def largest_load(arm: RigidArm, draw: np.random.Generator) -> Array:
    """Largest gravity moment of each axis over random postures [N·m], (axes,)."""
    import mujoco

    model, data = mujoco_model(arm, STEP)
    found = np.zeros(len(arm.links))
    for q in draw.uniform(*arm.limits.T, (200, len(arm.links))):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        found = np.maximum(found, np.abs(data.qfrc_bias))
    return found


def record(
    arm: RigidArm, compliance: Array, delay: Array, lag: Array, draw: np.random.Generator, seconds: float, smooth: bool
) -> pd.DataFrame:
    """One recording without noise: ``time``, ``<axis>.command`` and ``<axis>.joint`` [rad]."""
    time = np.arange(round(seconds / STEP)) * STEP
    low, high = arm.limits.T
    if smooth:
        setpoint, _, _ = fourier(draw, time, low, high, 0.08, 5, np.full(len(low), 2.0))
    else:
        setpoint = moves(draw, time, low, high, np.full(len(low), 2.5))
    every = round(1.0 / (RATE * STEP))
    # A bus sends the setpoint with each row of the log, and the servo holds it.
    setpoint = np.repeat(setpoint[::every], every, axis=0)[: len(time)]
    q = simulate(arm, compliance, delay, lag, setpoint)
    table: dict[str, Any] = {"time": time[::every]}
    for k, name in enumerate(arm.names):
        table[f"{name}.command"] = setpoint[::every, k]
    for k, name in enumerate(arm.names):
        table[f"{name}.joint"] = q[::every, k]
    return pd.DataFrame(table)


def simulate(arm: RigidArm, compliance: Array, delay: Array, lag: Array, setpoint: Array) -> Array:
    """Joint angles (n, axes) on the grid of the simulation; the arm begins at rest in its first posture."""
    import mujoco

    model, data = mujoco_model(arm, STEP)
    steps = np.rint(delay / STEP).astype(int)
    late = np.column_stack([np.r_[np.full(s, c[0]), c[: len(c) - s]] for s, c in zip(steps, setpoint.T, strict=True)])
    stiff = 1.0 / compliance
    # Stiff servos settle no faster than the step of the simulation allows.
    stiff = np.minimum(stiff, 2000.0)
    share = 1.0 - np.exp(-STEP / lag)
    reference = setpoint[0].copy()
    data.qpos[:] = reference
    mass = np.empty((len(stiff), len(stiff)))
    mujoco.mj_forward(model, data)
    for _ in range(20):
        data.qpos[:] = reference - data.qfrc_bias / stiff
        mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    damping = 1.4 * np.sqrt(stiff * np.diag(mass))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.dof_damping[:] = damping
    q = np.empty_like(setpoint)
    for k in range(len(setpoint)):
        q[k] = data.qpos
        reference += share * (late[k] - reference)
        data.qfrc_applied[:] = stiff * (reference - data.qpos)
        mujoco.mj_step(model, data)
    return q
