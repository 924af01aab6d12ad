"""Row ``servo_arm``: arms of two to seven position servos in MuJoCo, described by the MJCF that their user has.

The machine differs from the model in up to three of: dry friction, armature, mass of a link, stiffness and damping of a
controller, its force limit, dead time of its command, backlash between motor and joint. Hobby servos to industrial arms, logged
at 50 to 200 Hz.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from arms.case import Case, Hidden, noisy
from arms.motion import fourier
from sysid.datasets.robot_files import Choices, drafted_files

Array = npt.NDArray[np.float64]

NAME = "servo_arm"
STEP, RATES, SECONDS, REACH = 1e-3, (50.0, 100.0, 200.0), 25.0, 2.5
DIRECTIONS = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0", "0 1 0")
GRAVITY = 9.81
#: Share of the samples in which a force limit has to act for its name to be due.
LIMITED = 2e-3
#: Least crossings of a backlash in all recordings: on one flank it is an offset.
CROSSED = 10
#: Hidden effect → field of the arm that it multiplies, and its factors.
RATIOS = {
    "armature_error": ("armature", (1.5, 2.0)),
    "stiffness_error": ("kp", (0.75, 0.85, 1.2, 1.3)),
    "damping_error": ("kv", (0.75, 0.85, 1.2, 1.3)),
    "link_mass_error": ("mass", (0.75, 0.85, 1.2, 1.3)),
}


@dataclass(frozen=True)
class ServoArm:
    """Links from the base on: length [m], mass [kg]; joints: damping, armature, dry friction; controllers: gains, force limit.

    ``late``: dead time of each command, in steps of the simulation; ``backlash``: full width [rad].
    """

    length: Array
    mass: Array
    damping: Array
    armature: Array
    friction: Array
    kp: Array
    kv: Array
    limit: Array
    late: npt.NDArray[np.int64]
    backlash: Array

    @property
    def names(self) -> list[str]:
        return [f"j{k}" for k in range(len(self.mass))]


def cases(seed: int) -> Iterator[Case]:
    """One arm."""
    yield make(seed)


def make(seed: int, hides: bool = True) -> Case:
    """One arm; without anything hidden it is as its model."""
    draw = np.random.default_rng([seed, 7])
    arm = random_arm(draw, int(draw.integers(2, 8)))
    true, hidden = hide(draw, arm) if hides else (arm, [])
    rate, noise = float(draw.choice(RATES)), float(10.0 ** draw.uniform(-4.0, -3.2))
    encoders = {f"{name}.joint": noise for name in arm.names}
    runs = [record(true, np.random.default_rng([seed, 7, k]), rate, smooth=k % 2 == 1) for k in range(4)]
    idle = (true.backlash > 0.0) & (sum(crossed for _, _, crossed in runs) < CROSSED)
    if idle.any():
        true = replace(true, backlash=np.where(idle, 0.0, true.backlash))
        hidden = [each for each in hidden if each.name != "backlash" or not idle[arm.names.index(each.target)]]
        runs = [record(true, np.random.default_rng([seed, 7, k]), rate, smooth=k % 2 == 1) for k in range(4)]
    clean = {f"motion-{k + 1}": run for k, (run, _, _) in enumerate(runs)}
    logs = {name: noisy(run, encoders, draw) for name, run in clean.items()}
    limited = np.mean([at_limit for _, at_limit, _ in runs], axis=0)
    hidden = [each if each.name != "force_limit" else replace(each, due=_acts(each, arm, limited)) for each in hidden]
    extra = {"encoder_noise": noise, "joints": len(arm.mass)}
    return Case(NAME, f"{NAME}-{seed:03d}", rate, (), logs, clean, hidden, files=described(arm, rate), extra=extra)


def _acts(each: Hidden, arm: ServoArm, limited: Array) -> bool:
    return bool(limited[arm.names.index(each.target)] >= LIMITED)


def random_arm(draw: np.random.Generator, joints: int) -> ServoArm:
    """A hobby arm of 0.1 m links and 0.2 kg to an industrial one of 0.5 m and 5 kg."""
    size = float(np.exp(draw.uniform(np.log(0.1), np.log(0.5))))
    length, mass = size * draw.uniform(0.7, 1.3, joints), 20.0 * size**2 * draw.uniform(0.5, 1.5, joints)
    inertia, load = np.empty((2, joints))
    for k in range(joints):
        centres = np.cumsum(length[k:]) - 0.5 * length[k:]
        inertia[k], load[k] = mass[k:] @ centres**2, GRAVITY * (mass[k:] @ centres)
    armature = inertia * draw.uniform(0.1, 0.5, joints)
    kp = np.maximum((inertia + armature) * draw.uniform(8.0, 30.0, joints) ** 2, load * draw.uniform(6.0, 15.0, joints))
    kv = 2.0 * draw.uniform(0.6, 1.2, joints) * np.sqrt(kp * (inertia + armature))
    limit = 2.0 * load + kp * draw.uniform(0.3, 0.6, joints)
    nothing = np.zeros(joints)
    return ServoArm(length, mass, 0.1 * kv, armature, nothing, kp, kv, limit, nothing.astype(np.int64), nothing)


def hide(draw: np.random.Generator, arm: ServoArm) -> tuple[ServoArm, list[Hidden]]:
    """The machine, and how it differs from its model. The first joint is vertical: its link is a part of its armature."""
    kinds = ("coulomb_friction", "input_delay", "force_limit", "backlash", *RATIOS)
    true, hidden = arm, list[Hidden]()
    for _ in range(int(draw.integers(0, 4))):
        kind, k = str(draw.choice(kinds)), int(draw.integers(len(arm.mass)))
        alike = ("armature_error", "link_mass_error") if k == 0 and kind in ("armature_error", "link_mass_error") else (kind,)
        if any(each.target == arm.names[k] and each.name in alike for each in hidden):
            continue
        if kind in RATIOS:
            part, factors = RATIOS[kind]
            value = float(draw.uniform(*factors)) if len(factors) == 2 else float(draw.choice(factors))
            true, stated = _changed(true, part, k, value * getattr(true, part)[k]), {"ratio": value}
        elif kind == "coulomb_friction":
            force = float(arm.kp[k] * draw.uniform(0.01, 0.03))
            true, stated = _changed(true, "friction", k, force), {"force": force}
        elif kind == "force_limit":
            limit = float(0.55 * arm.limit[k])
            true, stated = _changed(true, "limit", k, limit), {"limit": limit}
        elif kind == "backlash":
            width = float(draw.uniform(0.005, 0.03))
            true, stated = _changed(true, "backlash", k, width), {"width": width}
        else:
            steps = int(draw.integers(20, 61))
            true, stated = _changed(true, "late", k, steps), {"delay": steps * STEP}
        hidden.append(Hidden(kind, arm.names[k], stated))
    return true, hidden


def _changed(arm: ServoArm, part: str, k: int, value: float) -> ServoArm:
    values = getattr(arm, part).copy()
    values[k] = value
    return replace(arm, **{part: values})


def model_text(arm: ServoArm) -> str:
    """The arm as MJCF."""
    bodies, actuators = "", ""
    for k, name in enumerate(arm.names):
        place = "0 0 0.1" if k == 0 else f"{arm.length[k - 1]:.9g} 0 0"
        bodies += (
            f'<body name="link{k}" pos="{place}"><joint name="{name}" axis="{DIRECTIONS[k]}" range="-{REACH} {REACH}" '
            f'damping="{arm.damping[k]:.9g}" armature="{arm.armature[k]:.9g}" frictionloss="{arm.friction[k]:.9g}"/>'
            f'{behind(arm, k)}<geom type="capsule" fromto="0 0 0 {arm.length[k]:.9g} 0 0" size="{0.1 * arm.length[k]:.9g}" '
            f'mass="{arm.mass[k]:.9g}" contype="0" conaffinity="0"/>'
        )
        actuators += (
            f'<position name="{name}" joint="{name}" kp="{arm.kp[k]:.9g}" kv="{arm.kv[k]:.9g}" ctrlrange="-{REACH} {REACH}" '
            f'forcerange="{-arm.limit[k]:.9g} {arm.limit[k]:.9g}"/>'
        )
    tip = f'<site name="tip" pos="{arm.length[-1]:.9g} 0 0"/>'
    return (
        f'<mujoco model="arm"><compiler angle="radian"/><option timestep="{STEP}" integrator="implicitfast"/>'
        f"<worldbody>{bodies}{tip}{'</body>' * len(arm.mass)}</worldbody><actuator>{actuators}</actuator></mujoco>"
    )


def behind(arm: ServoArm, k: int) -> str:
    """The joint of a link behind that of its motor, with the stiff ends of a gear; none without backlash."""
    half = 0.5 * arm.backlash[k]
    ends = f'range="{-half:.9g} {half:.9g}" solreflimit="0.002 1" solimplimit="0.99 0.999 0.0001"'
    return f'<joint name="{arm.names[k]}_link" axis="{DIRECTIONS[k]}" {ends}/>' if half > 0.0 else ""


def described(arm: ServoArm, rate_hz: float) -> dict[str, str]:
    """The files of the machine that ``sysid init --from`` drafts from the model, with the rate of the logs."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.xml"
        path.write_text(model_text(arm), "utf-8")
        files = dict(drafted_files(path, "arm", Choices()).files)
    del files["recipe.toml"]
    lines = [f"rate_hz = {rate_hz}" if line.startswith("rate_hz") else line for line in files["machine.toml"].splitlines()]
    return files | {"machine.toml": "\n".join(lines) + "\n"}


def record(arm: ServoArm, draw: np.random.Generator, rate_hz: float, smooth: bool) -> tuple[pd.DataFrame, Array, Array]:
    """One recording without noise, the share of it that each controller is at its force limit, and crossings of backlash."""
    import mujoco

    every, count = round(1.0 / (rate_hz * STEP)), round(SECONDS * rate_hz)
    time, joints = np.arange(count) / rate_hz, len(arm.mass)
    if smooth:
        low = np.full(joints, -1.0)
        wanted, _, _ = fourier(draw, time, low, -low, 0.1, 8, np.full(joints, 4.0))
        wanted = wanted - wanted[0]
    else:
        wanted = np.zeros((count, joints))
        for k in range(joints):
            at = round(rate_hz)
            while at < count:
                ahead = at + round(draw.uniform(0.5, 1.5) * rate_hz)
                wanted[at:ahead, k], at = draw.uniform(-1.0, 1.0), ahead
    model = mujoco.MjModel.from_xml_string(model_text(arm))
    data, control = mujoco.MjData(model), np.repeat(wanted, every, axis=0)
    control = np.column_stack([np.r_[np.full(n, c[0]), c[: len(c) - n]] for n, c in zip(arm.late, control.T, strict=True)])
    data.ctrl[:] = control[0]
    mujoco.mj_step(model, data, round(6.0 / STEP))
    places = [int(model.joint(name).qposadr[0]) for name in arm.names]
    links = [k for k in range(joints) if arm.backlash[k] > 0.0]
    joint, limited, between = np.empty((count, joints)), np.zeros(joints), np.zeros((count, joints))
    for k in range(count):
        between[k, links] = data.qpos[[places[n] + 1 for n in links]]
        joint[k] = data.qpos[places] + between[k]
        for row in control[k * every : (k + 1) * every]:
            data.ctrl[:] = row
            mujoco.mj_step(model, data)
        limited += np.abs(data.actuator_force) >= arm.limit * (1.0 - 1e-9)
    table: dict[str, Any] = {"time": time}
    table |= {f"{name}.command": wanted[:, k] for k, name in enumerate(arm.names)}
    table |= {f"{name}.joint": joint[:, k] for k, name in enumerate(arm.names)}
    flank = np.sign(between)
    return pd.DataFrame(table), limited / count, np.count_nonzero(flank[1:] * flank[:-1] < 0.0, axis=0)
