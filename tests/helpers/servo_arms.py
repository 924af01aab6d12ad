"""Arms of servos as MJCF, their logs from MuJoCo, and the machines that are drafted from them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.machine import Machine, machine_from_files
from sysid.machine.sources.draft import machine_text
from sysid.machine.sources.mjcf import mjcf_draft
from sysid.plant.model import Model

Array = npt.NDArray[np.float64]

#: Friction of a joint that does not give way.
STIFF = 'solreffriction="0.002 1" solimpfriction="0.9999 0.9999 0.001"'


def arm_text(
    joints: int, seed: int = 0, *, step: float = 0.001, integrator: str = "implicitfast", limited: float = 0.0, rubs: str = "",
    delay: float = 0.0, backlash: float = 0.0, lag: float = 0.0,
) -> str:  # fmt: skip
    """An arm of ``joints`` hinges with random directions, masses, gains, damping and armature.

    Args:
        step: of MuJoCo [s].
        limited: force limit of each joint as a share of kp [rad]; 0 for none.
        rubs: attributes of the friction of every second joint; empty for none.
        delay: of every control [s], through MuJoCo's control history.
        lag: of every control [s], by its filter.
        backlash: of every joint, by a second one with hard ends behind it [rad].
    """
    rng, bodies, actuators = np.random.default_rng(seed), "", ""
    for k in range(joints):
        size = 0.8**k
        axis = ("0 0 1", "0 1 0", "0 1 0", "1 0 0")[k % 4]
        friction = f'frictionloss="{0.3 * size:.4f}" {rubs}' if rubs and k % 2 else ""
        bodies += (
            f'<body name="b{k}" pos="0 0 {0.1 if k == 0 else 0.18 * 0.9 ** (k - 1):.4f}">'
            f'<joint name="j{k}" axis="{axis}" range="-2.5 2.5" damping="{0.08 * size:.4f}" {friction} '
            f'armature="{rng.uniform(0.01, 0.03) * size**2:.5f}"/>{behind(k, axis, backlash)}'
            f'<inertial pos="{rng.uniform(-0.01, 0.01):.4f} 0 {0.09 * 0.9**k:.4f}" mass="{0.5 * size**2:.4f}" '
            f'diaginertia="{2e-3 * size**3:.6f} {1.8e-3 * size**3:.6f} {6e-4 * size**3:.6f}"/>'
        )
        kp, kv = rng.uniform(30.0, 50.0) * size**2, rng.uniform(1.0, 2.0) * size**2
        limit = f'forcerange="{-limited * kp:.4f} {limited * kp:.4f}"' if limited else ""
        late = f'delay="{delay}" nsample="{round(delay / step) + 2}"' if delay else ""
        filtered = f'timeconst="{lag}"' if lag else ""
        actuators += f'<position name="a{k}" joint="j{k}" kp="{kp:.4f}" kv="{kv:.4f}" {limit} {late} {filtered}/>'
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="{integrator}"/>'
        f'<worldbody>{bodies}<site name="tip" pos="0 0 0.05"/>{"</body>" * joints}</worldbody>'
        f"<actuator>{actuators}</actuator></mujoco>"
    )


def behind(k: int, axis: str, backlash: float) -> str:
    """The joint behind joint ``k`` that a backlash needs; it stores no energy at its ends."""
    if not backlash:
        return ""
    ends = f'range="{-0.5 * backlash} {0.5 * backlash}" solreflimit="0.002 3" solimplimit="0.9999 0.9999 0.001"'
    return f'<joint name="p{k}" axis="{axis}" limited="true" {ends}/>'


def commands(joints: int, count: int, dt: float, seed: int = 0) -> Array:
    """Steps and smooth motion of all joints, (count, joints) [rad]."""
    rng, time = np.random.default_rng(seed), np.arange(count) * dt
    found = np.zeros((count, joints))
    for k in range(joints):
        levels = rng.uniform(-0.6, 0.6, count)[(time / rng.uniform(0.8, 1.6)).astype(int)]
        waves = sum(0.2 * np.sin(2.0 * np.pi * f * time) for f in rng.uniform(0.1, 0.8, 2))
        found[:, k] = np.where(time > 1.0, np.where(time < 0.5 * time[-1], levels, waves), 0.0)
    return found


def logged(text: str, wanted: Array, dt: float) -> Array:
    """Positions of MuJoCo (count, joints): at each sample the command is written, the position read, then time goes on."""
    model = mujoco.MjModel.from_xml_string(text)
    data, steps = mujoco.MjData(model), round(dt / model.opt.timestep)
    data.ctrl[:] = wanted[0]
    for _ in range(round(4.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    found, each = np.empty(wanted.shape), len(data.qpos) // wanted.shape[1]
    for k, row in enumerate(wanted):
        data.ctrl[:], found[k] = row, data.qpos.reshape(-1, each).sum(axis=1)
        for _ in range(steps):
            mujoco.mj_step(model, data)
    return found


def drafted(folder: Path, text: str, kind: str | None = None) -> Machine:
    """The machine that ``sysid init --from`` drafts."""
    path = folder / "arm.xml"
    path.write_text(text, "utf-8")
    draft = mjcf_draft(path, kind=kind)
    return machine_from_files({"machine.toml": machine_text(draft, "arm"), "arm.urdf": draft.urdf}, "arm")


def recording_of(wanted: Array, joints: Array, dt: float, machine: Machine) -> Recording:
    """A recording of commands and joints, (count, A) each."""
    columns = {"time": np.arange(len(wanted)) * dt}
    for k, name in enumerate(machine.axis_names):
        columns |= {f"{name}.command": wanted[:, k], f"{name}.joint": joints[:, k]}
    return Recording("arm", pd.DataFrame(columns), 1.0 / dt)


def shares(found: Array, true: Array) -> Array:
    """RMS difference of each column as a share of its range."""
    return np.asarray(np.sqrt(np.nanmean((found - true) ** 2, axis=0)) / np.ptp(true, axis=0))


def alone(model: Model, recording: Recording) -> Array:
    """Run of each axis by itself at the measured motion of the others, (n, A)."""
    theta = model.theta[None]
    return np.column_stack([model.drive(theta, recording, name)[0] for name in model.machine.axis_names])
