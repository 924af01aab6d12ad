"""Servo axes of machine.toml: what they accept, what they say about a mistake, and what is drafted from an MJCF."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from servo_arms import STIFF, arm_text, drafted

from sysid.errors import SettingsError
from sysid.machine import KnownEffect, Machine, machine_from_files
from sysid.plant import nominal_plant
from sysid.plant.stepper import Stepper
from sysid.testing.probe import probe_arm

ONE = """schema = 1
name = "one"
rate_hz = 100.0
[[axes]]
name = "turn"
joint_type = "revolute"
actuation = "servo"
drives = "joint"
inertia = 0.02
servo = { kp = 18.0, kv = 0.7, force_limit = 4.0 }
"""


def changed(before: str, after: str) -> Machine:
    assert before in ONE
    return machine_from_files({"machine.toml": ONE.replace(before, after, 1)}, "machine.toml")


def test_a_controller_with_its_defaults() -> None:
    law = changed(", kv = 0.7, force_limit = 4.0", "").axis("turn").servo
    assert law is not None
    assert (law.kp, law.kv, law.force_range, law.step) == (18.0, 0.0, (-math.inf, math.inf), 0.0)


@pytest.mark.parametrize(("stated", "ends"), [("4.0", (-4.0, 4.0)), ("[-3.0, 5.0]", (-3.0, 5.0))])
def test_force_limits(stated: str, ends: tuple[float, float]) -> None:
    law = changed("force_limit = 4.0", f"force_limit = {stated}").axis("turn").servo
    assert law is not None
    assert law.force_range == ends


def test_its_command_is_a_position() -> None:
    machine = changed("kv", "kv")
    assert machine.expected_unit("turn.command") == "rad"
    assert machine.axis("turn").follows_positions
    assert machine.drive_of("turn") == "electric"


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("kp = 18.0", "kp = 0.0", r"axes\[0\]\.servo\.kp = 0\.0; expected a number greater than"),
        ("kp = 18.0, ", "", r"key 'axes\[0\]\.servo\.kp' is missing"),
        ("kv = 0.7", "kd = 0.7", r"unknown key 'axes\[0\]\.servo\.kd'; expected one of: .*kp, kv"),
        ("kv = 0.7", "kv = -0.7", r"axes\[0\]\.servo\.kv = -0\.7"),
        ("force_limit = 4.0", "force_limit = [1.0, 4.0]", r"servo\.force_limit: \[1, 4\]; expected a range around zero"),
        (
            'drives = "joint"',
            'drives = "cylinder"\nstroke = [0.0, 1.0]',
            r"drives: 'cylinder'; expected 'joint' on a servo axis",
        ),
        ("servo = { kp = 18.0, kv = 0.7, force_limit = 4.0 }\n", "", r"'turn': no controller; expected servo = \{ kp"),
        ('actuation = "servo"', 'actuation = "position"', r"servo: a controller on a position axis; expected a servo axis"),
        ("inertia = 0.02\n", "", r"'turn': no inertia; expected inertia .* of what a servo axis moves, or a URDF"),
        ("inertia = 0.02", "inertia = 0.0", r"'turn': inertia: 0; expected at least .*, or a URDF with the masses"),
    ],
)
def test_mistakes_are_said(before: str, after: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        changed(before, after)


def test_all_axes_of_a_machine_are_servos_or_none() -> None:
    other = '[[axes]]\nname = "lift"\nactuation = "velocity"\ndrives = "joint"\n'
    with pytest.raises(SettingsError, match=r"beside 'lift', a velocity axis; expected a machine with servo axes only"):
        machine_from_files({"machine.toml": ONE + other}, "machine.toml")


def test_a_rotor_without_inertia_on_links_with_masses() -> None:
    files = probe_arm().files()
    servo = 'actuation = "servo"\ninertia = 0.0\nservo = { kp = 50.0, kv = 3.0 }'
    machine = machine_from_files({**files, "machine.toml": files["machine.toml"].replace('actuation = "force"', servo)}, "arm")
    assert [axis.inertia for axis in machine.axes] == [0.0, 0.0]


@pytest.mark.parametrize("name", ["load_bias", "second_order_lag"])
def test_effects_of_other_axes_are_refused(name: str) -> None:
    parameters = {
        "load_bias": "force = 1.0",
        "second_order_lag": "time_constant = 0.1, damping_ratio = 1.0",
    }
    effect = f'\n[[effects]]\nname = "{name}"\ntarget = "turn"\nparameters = {{ {parameters[name]} }}\n'
    machine = machine_from_files({"machine.toml": ONE + effect}, "machine.toml")
    with pytest.raises(SettingsError, match="target 'turn' is servo-actuated"):
        nominal_plant(machine)


def test_a_payload_is_refused_with_its_remedy() -> None:
    """The links of a servo arm move by the masses of its URDF alone."""
    effect = '\n[[effects]]\nname = "payload"\ntarget = "tool"\nparameters = { mass = 1.0, centre = [0.0, 0.0, 0.0] }\n'
    machine = machine_from_files({"machine.toml": ONE + effect}, "machine.toml")
    with pytest.raises(SettingsError, match="Add the mass to the last link of the URDF"):
        nominal_plant(machine)


def test_errors_of_the_structure_are_those_of_any_axis(tmp_path: Path) -> None:
    machine = drafted(tmp_path, arm_text(2, 1))
    plant = nominal_plant(machine).with_effect(KnownEffect("joint_offset", machine.axis_names[0], {"offset": 0.1}))
    ends = [Stepper(each, 100.0).reset([0.2, 0.3]).ee[0] for each in (nominal_plant(machine), plant)]
    turned = Stepper(nominal_plant(machine), 100.0).reset([0.3, 0.3]).ee[0]
    assert ends[1] == pytest.approx(turned, abs=1e-9)
    assert abs(ends[1] - ends[0]).max() > 1e-3


def test_a_draft_has_the_controller_of_the_compiled_model(tmp_path: Path) -> None:
    """Gear, damping ratio, ranges of joint and actuator, armature of both, friction and damping."""
    text = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody><body>
      <joint name="a" axis="0 1 0" range="-1 1" damping="0.2" armature="0.03" actuatorfrcrange="-50 40" frictionloss="0.5"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="1"/><body pos="0.3 0 0">
      <joint name="b" axis="0 1 0" range="-1 1" armature="0.02"/><geom size="0.02" mass="0.2" pos="0.1 0 0"/>
      <site name="tip"/></body></body></worldbody><actuator>
      <general name="one" joint="a" gear="-10" gainprm="2" biastype="affine" biasprm="0 -2 -0.1" forcerange="-6 3"/>
      <position name="two" joint="b" kp="30" dampratio="1"/></actuator></mujoco>"""
    machine = drafted(tmp_path, text)
    one, two = machine.axes
    assert (one.actuation, two.actuation) == ("servo", "servo")
    assert one.servo is not None
    assert two.servo is not None
    assert (one.servo.kp, one.servo.kv, *one.servo.force_range) == pytest.approx((200.0, 10.0, -30.0, 40.0))
    assert one.inertia == pytest.approx(0.03)
    assert two.servo.kv > 1.0, "resolved from the damping ratio"
    assert two.servo.force_limit is None
    assert (one.servo.step, one.servo.implicit) == (0.002, True)
    effects = {(e.name, e.target): e.parameters for e in machine.effects}
    assert effects["viscous_friction", "a"] == {"coefficient": pytest.approx(0.2)}
    assert effects["coulomb_friction", "a"] == {"force": pytest.approx(0.5)}
    assert not machine.left_out


def test_dry_friction_of_the_draft_gives_way_as_its_constraint(tmp_path: Path) -> None:
    soft, stiff = (drafted(tmp_path, arm_text(2, rubs=rubs)).axes[1].servo for rubs in (" ", STIFF))
    assert soft is not None
    assert stiff is not None
    assert soft.friction_time == pytest.approx(0.5 * 0.95 * 0.02 - 0.0005)
    assert stiff.friction_give < 1e-4 * soft.friction_give


@pytest.mark.parametrize(
    ("before", "after", "reason"),
    [
        ("<mujoco>", '<mujoco><default><position forcerange="1 2"/></default>', "a force range without zero"),
        ("<option ", '<option gravity="9.81 0 0" ', "no gravity along −z"),
    ],
)
def test_other_laws_are_drafted_by_their_responses(before: str, after: str, reason: str, tmp_path: Path) -> None:
    text = arm_text(2)
    assert before in text
    machine = drafted(tmp_path, text.replace(before, after, 1))
    assert [axis.actuation for axis in machine.axes] == ["position", "position"]
    assert any(line.startswith("controllers of j0 and j1, which are described") and reason in line for line in machine.left_out)


def test_responses_on_request(tmp_path: Path) -> None:
    machine = drafted(tmp_path, arm_text(2), kind="response")
    assert [axis.actuation for axis in machine.axes] == ["position", "position"]
    assert {effect.name for effect in machine.effects} == {"second_order_lag", "joint_compliance"}
