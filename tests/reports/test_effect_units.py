"""Units of effect parameters follow the axis that they sit on."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sysid.datasets.recording import Dataset
from sysid.effects.units import parameter_unit
from sysid.machine import Axis, Machine, machine_from_files
from sysid.reports.result_figures import parameters_of
from sysid.reports.words import remainder_unit


def text_of(effect: str, parameter: str, target: str, value: float, machine: Machine) -> str:
    return parameters_of(effect, target, {parameter: value}, machine)[0].text


@pytest.mark.parametrize(
    ("effect", "parameter", "target", "unit"),
    [
        ("backlash", "width", "slew", "rad"),
        ("backlash", "width", "telescope", "m"),
        ("backlash", "width", "stick", "rad"),
        ("joint_offset", "offset", "boom", "rad"),
        ("valve_deadband", "positive", "boom", "1"),
        ("gripper_sway", "length", "tool", "m"),
        ("sensor_bias", "bias", "boom.joint", "rad"),
        ("sensor_bias", "bias", "boom.cylinder", "m"),
        ("sensor_quantisation", "step", "tool.x", "m"),
        ("sensor_scale", "scale", "slew.joint", "1"),
        ("input_delay", "delay", "stick", "s"),
        ("no_such_effect", "width", "slew", "1"),
    ],
)
def test_unit(crane: Dataset, effect: str, parameter: str, target: str, unit: str) -> None:
    assert parameter_unit(effect, parameter, target, crane.machine) == unit


def test_a_prismatic_force_axis_without_geometry_has_newtons(crane: Dataset) -> None:
    slide = Axis("slide", "force", "joint", inertia=95.0, joint_type="prismatic")
    machine = replace(crane.machine, axes=(slide,), urdf=None, urdf_text=None, tip=None, tool=None)
    assert text_of("coulomb_friction", "force", "slide", 20.71, machine) == "20.7\u202fN"
    assert text_of("viscous_friction", "coefficient", "slide", 203.0, machine) == "203\u202fN·s/m"


def test_a_revolute_force_axis_without_geometry_has_newton_metres(crane: Dataset) -> None:
    axes = (Axis("j1", "force", "joint", inertia=0.2), Axis("j2", "force", "joint", inertia=0.2, joint_type="revolute"))
    machine = replace(crane.machine, axes=axes, urdf=None, urdf_text=None, tip=None, tool=None)
    for name in ("j1", "j2"):
        assert parameter_unit("coulomb_friction", "force", name, machine) == "N·m"
        assert parameter_unit("viscous_friction", "coefficient", name, machine) == "N·m·s/rad"
        assert parameter_unit("stribeck_friction", "stribeck_velocity", name, machine) == "rad/s"
        assert parameter_unit("joint_compliance", "compliance", name, machine) == "rad/(N·m)"


def test_the_load_of_a_joint_behind_a_cylinder_is_a_moment(crane: Dataset) -> None:
    assert parameter_unit("load_dependent_flow", "coefficient", "boom", crane.machine) == "1/(N·m)"
    assert parameter_unit("joint_compliance", "compliance", "telescope", crane.machine) == "m/N"


def test_a_sensor_of_a_servo_without_geometry_reads_an_angle(crane: Dataset) -> None:
    servo = Axis("pitch", "position", "joint")
    machine = replace(crane.machine, axes=(servo,), urdf=None, urdf_text=None, tip=None, tool=None)
    assert text_of("sensor_bias", "bias", "pitch.joint", 0.037, machine) == "2.12°"


@pytest.mark.parametrize(
    ("stage", "target", "unit"),
    [
        ("command", "boom", "m"),
        ("command", "slew", "rad"),
        ("joint", "boom", "rad"),
        ("force", "slew", "N·m"),
        ("end_effector", "ee", "m"),
        ("tool", "tool", "m"),
    ],
)
def test_what_is_left_over_has_the_unit_of_the_signal_that_its_stage_predicts(
    crane: Dataset, stage: str, target: str, unit: str
) -> None:
    units = {**crane.units, "slew.command": "N·m"}
    assert remainder_unit(stage, target, crane.machine, units) == unit


def test_a_turning_force_axis_without_urdf_has_newton_metres_where_its_joint_is_measured_in_radians() -> None:
    text = 'schema = 1\nname = "m"\nrate_hz = 50.0\n'
    for name, actuation in (("arm", "force"), ("pitch", "position"), ("boom", "velocity")):
        inertia = "inertia = 1.0\n" if actuation == "force" else ""
        text += f'[[axes]]\nname = "{name}"\nactuation = "{actuation}"\ndrives = "joint"\n'
        text += f"limits = [-1.0, 1.0]\ngain = 1.0\n{inertia}"
    machine = machine_from_files({"machine.toml": text}, "test")
    turning, sliding = {"arm.joint": "rad", "pitch.joint": "rad"}, {"arm.joint": "m", "pitch.joint": "m"}
    assert parameter_unit("coulomb_friction", "force", "arm", machine, turning) == "N·m"
    assert parameter_unit("coulomb_friction", "force", "arm", machine, sliding) == "N"
    assert parameter_unit("command_rate_limit", "rate", "pitch", machine, turning) == "rad/s"
    assert parameter_unit("command_rate_limit", "rate", "pitch", machine, sliding) == "m/s"
    assert parameter_unit("command_rate_limit", "rate", "boom", machine, turning) == "1/s"
    assert parameter_unit("sensor_bias", "bias", "arm.joint", machine, turning) == "rad"
