"""A servo arm, an arm of geared motors and a slide, from a recipe to CSV logs.

kind = "servo_arm" or "torque_arm"       kind = "slide"
name, seed, rate                         name, seed, rate
[[axes]] name, limits, length, …         mass, coulomb, viscous, …
[[recordings]] name, seed, seconds       [[recordings]] name, seed, seconds

Columns have canonical names, but for the currents of the motors: ``<axis>.current`` [A].
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from simulated_bench.joint_recipe import STEP, ServoArm, ServoAxis, Slide
from simulated_bench.servo_arm import run_servo_arm
from simulated_bench.slide import run_slide
from simulated_bench.torque_arm import TorqueArm, description, run_torque_arm
from sysid.config import parse_settings, read_toml
from sysid.errors import SettingsError

JointMachine = ServoArm | TorqueArm | Slide


def load_joint_machine(path: Path) -> JointMachine:
    """Read and check a recipe of either kind.

    Raises:
        SettingsError: an unknown kind or key, a value that no machine can have.
    """
    values = read_toml(path)
    kind = values.get("kind")
    if kind == "servo_arm":
        arm = parse_settings(values, ServoArm, path)
        for axis in arm.axes:
            if not axis.limits[0] < axis.limits[1] or min(axis.length, axis.mass, axis.rate_limit) <= 0.0:
                raise SettingsError(
                    f"{path}: axis {axis.name!r}", "no range, length, mass or rate", "limits in order, sizes > 0"
                )
        _check_rate(arm.rate, path)
        return arm
    if kind == "slide":
        slide = parse_settings(values, Slide, path)
        if min(slide.mass, slide.stiffness, slide.force_limit, slide.stribeck, slide.stroke, slide.pitch) <= 0.0:
            what = "a mass, stiffness, force limit, stribeck speed, stroke or pitch of zero or less"
            raise SettingsError(path, what, "more than zero")
        if slide.bristle < 0.0:
            raise SettingsError(f"{path}: bristle", f"{slide.bristle}", "zero or more")
        _check_rate(slide.rate, path)
        return slide
    if kind == "torque_arm":
        motors = parse_settings(values, TorqueArm, path)
        for motor in motors.axes:
            if not motor.limits[0] < motor.limits[1] or min(motor.length, motor.mass, motor.rotor, motor.constant) <= 0.0:
                place = f"{path}: axis {motor.name!r}"
                raise SettingsError(place, "no range, length, mass, rotor or constant", "limits in order, sizes > 0")
        _check_rate(motors.rate, path)
        return motors
    raise SettingsError(f"{path}: kind", repr(kind), "'servo_arm', 'torque_arm' or 'slide'")


def _check_rate(rate: float, path: Path) -> None:
    if abs(1.0 / (STEP * rate) - round(1.0 / (STEP * rate))) > 1e-9:
        raise SettingsError(f"{path}: rate", f"{rate} Hz", f"a rate that divides {1.0 / STEP:.0f} Hz")


def write_joint_machine(machine: JointMachine, out: Path) -> list[Path]:
    """``out/<recording>/log.csv``, ``out/machine.toml`` and, for an arm, its URDF; returns the files."""
    out.mkdir(parents=True, exist_ok=True)
    written = []
    for take in machine.recordings:
        noise = np.random.default_rng([machine.seed, take.seed, 1])
        if isinstance(machine, ServoArm):
            time, setpoint, joints = run_servo_arm(machine, take)
            seen = joints + machine.noise * noise.standard_normal(joints.shape)
            names = [f"{axis.name}.{part}" for part in ("command", "joint") for axis in machine.axes]
            table = np.column_stack([time, setpoint, seen])
        elif isinstance(machine, TorqueArm):
            time, current, joints = run_torque_arm(machine, take)
            seen = joints + machine.noise * noise.standard_normal(joints.shape)
            names = [f"{axis.name}.{part}" for part in ("current", "joint") for axis in machine.axes]
            table = np.column_stack([time, current + machine.current_noise * noise.standard_normal(current.shape), seen])
        else:
            time, force, position = run_slide(machine, take)
            names = ["carriage.command", "carriage.joint"]
            pushed = force + machine.force_noise * noise.standard_normal(len(force))
            table = np.column_stack([time, pushed, position + machine.noise * noise.standard_normal(len(position))])
        path = out / take.name / "log.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(["time", *names]), comments="")
        written.append(path)
    for name, text in description_of(machine).items():
        (out / name).write_text(text, "utf-8")
        written.append(out / name)
    return written


def description_of(machine: JointMachine) -> dict[str, str]:
    """``machine.toml`` and, for an arm, its URDF: file name → text. Features are not described."""
    if isinstance(machine, TorqueArm):
        return description(machine)
    if isinstance(machine, ServoArm):
        return {"machine.toml": _arm_toml(machine), f"{machine.name}.urdf": _arm_urdf(machine.name, machine.axes)}
    return {
        "machine.toml": f'schema = 1\nname = "{machine.name}"\nrate_hz = {machine.rate}\n\n[[axes]]\nname = "carriage"\n'
        f'joint_type = "prismatic"\nactuation = "force"\ndrives = "joint"\n'
        f"inertia = {machine.mass}\nlimits = [{-machine.stroke}, {machine.stroke}]\n"
    }


def _arm_toml(arm: ServoArm) -> str:
    lines = ["schema = 1", f'name = "{arm.name}"', f"rate_hz = {arm.rate}", f'urdf = "{arm.name}.urdf"', 'tip = "tip"']
    for axis in arm.axes:
        lines += ["", "[[axes]]", f'name = "{axis.name}"', f'joint = "{axis.name}_joint"']
        lines += ['actuation = "position"', 'drives = "joint"', "gain = 1.0"]
    return "\n".join(lines) + "\n"


def _arm_urdf(name: str, axes: Sequence[ServoAxis]) -> str:
    parts = [f'<?xml version="1.0"?>\n<robot name="{name}">\n  <link name="base"/>']
    parent, at = "base", 0.0
    for axis in axes:
        moment = axis.mass * axis.length**2 / 12.0
        parts.append(
            f'  <joint name="{axis.name}_joint" type="revolute"><parent link="{parent}"/><child link="{axis.name}_link"/>'
            f'<origin xyz="{at} 0 0"/><axis xyz="0 -1 0"/>'
            f'<limit lower="{axis.limits[0]}" upper="{axis.limits[1]}" velocity="10" effort="100"/></joint>\n'
            f'  <link name="{axis.name}_link"><inertial><origin xyz="{0.5 * axis.length} 0 0"/><mass value="{axis.mass}"/>'
            f'<inertia ixx="1e-6" ixy="0" ixz="0" iyy="{moment}" iyz="0" izz="{moment}"/></inertial></link>'
        )
        parent, at = f"{axis.name}_link", axis.length
    parts.append(
        f'  <joint name="tip_joint" type="fixed"><parent link="{parent}"/><child link="tip"/><origin xyz="{at} 0 0"/></joint>\n'
        '  <link name="tip"/>\n</robot>'
    )
    return "\n".join(parts) + "\n"
