"""``sysid init --from``: the machine of a URDF or MJCF, and what cannot be expressed."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from command_line import run
from robots import ROBOTS, robot

from sysid.machine import Machine, load_machine
from sysid.machine.rigid_body import rigid_body
from sysid.plant import compile_plant, nominal_plant


def drafted(tmp_path: Path, source: Path, *options: str) -> Machine:
    """The machine that ``init --from`` makes."""
    assert run("init", tmp_path / "mine", "--name", "mine", "--from", source, *options) == 0
    return load_machine(tmp_path / "mine" / "datasets" / "mine" / "machine.toml")


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "robot.xml"
    path.write_text(text, "utf-8")
    return path


def effects_of(machine: Machine) -> dict[tuple[str, str], dict[str, float]]:
    return {(item.name, item.target): item.parameters for item in machine.effects}  # type: ignore[misc]


#: Joints off the origin, rotated bodies, reference angles, two joints in one body, a fixed body, a site at an offset.
ODD = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="socket" pos="0.2 0 0.3" euler="0.3 0.2 0.1">
    <body name="yoke" pos="0 0.1 0" quat="0.8 0.1 -0.3 0.5">
      <joint name="first" axis="0.2 1 0.3" pos="0.05 0.02 -0.03" ref="0.4" range="-2 2"/>
      <joint name="second" type="slide" axis="1 0.5 0" pos="0.3 0 0" ref="0.1" range="-1 1"/>
      <joint name="third" axis="0 0.3 1" pos="-0.1 0.04 0" range="-2 2"/>
      <inertial pos="0.1 0.2 0.05" quat="0.9 0.2 0.1 0.4" mass="2" diaginertia="0.03 0.02 0.015"/>
      <body name="hand" pos="0.3 0 0.1" euler="0 1.5707963267948966 0.4">
        <joint name="fourth" axis="1 0 0" pos="0 0.02 0" ref="-0.3" range="-2 2"/>
        <inertial pos="0.02 0 0.1" mass="0.7" diaginertia="0.004 0.003 0.002"/>
        <site name="nail" pos="0.01 0.2 0.1" euler="0.1 0 0"/>
      </body>
    </body>
  </body></worldbody>
  <actuator><motor joint="first"/><motor joint="second"/><motor joint="third"/><motor joint="fourth"/></actuator>
</mujoco>
"""


def odd(tmp_path: Path) -> Path:
    return written(tmp_path, ODD)


def sources(tmp_path: Path) -> dict[str, Path]:
    return {**{name: robot(name) for name in ROBOTS}, "odd": odd(tmp_path)}


@pytest.mark.parametrize("name", [*ROBOTS, "odd"])
def test_the_urdf_of_an_mjcf_has_its_kinematics(name: str, tmp_path: Path) -> None:
    path = sources(tmp_path)[name]
    machine = drafted(tmp_path, path)
    kinematics = machine.kinematics()
    assert kinematics is not None
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    places = [model.joint(axis.joint).qposadr[0] for axis in machine.axes]
    ranges = np.array([axis.limits for axis in machine.axes])
    for q in np.random.default_rng(0).uniform(ranges[:, 0], ranges[:, 1], (20, len(places))):
        data.qpos[places] = q
        mujoco.mj_kinematics(model, data)
        found = data.site(machine.tip).xpos if machine.tip in sites(model) else data.body(machine.tip).xpos
        np.testing.assert_allclose(kinematics.tip_position(q)[0], found, atol=1e-9)


def sites(model: mujoco.MjModel) -> list[str]:
    return [model.site(k).name for k in range(model.nsite)]


@pytest.mark.parametrize("name", ["torque_arm", "odd"])
def test_the_urdf_of_an_mjcf_has_its_dynamics(name: str, tmp_path: Path) -> None:
    """Torques of the links without friction and rotors, at the gravity of the model."""
    path = sources(tmp_path)[name]
    machine = drafted(tmp_path, path)
    body = rigid_body(machine)
    assert body is not None
    model = mujoco.MjModel.from_xml_path(str(path))
    model.dof_damping[:] = model.dof_frictionloss[:] = model.dof_armature[:] = 0.0
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    for _ in range(10):
        q, v, a = rng.uniform(-0.8, 0.8, (3, model.nv))
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(body.torque(q[None], v[None], a[None], body.nominal)[0], data.qfrc_inverse, atol=1e-8)


def test_servos_follow_and_sag_as_in_the_model(tmp_path: Path) -> None:
    machine = drafted(tmp_path, robot("servo_arm"), "--kind", "response")
    assert [(axis.name, axis.actuation, axis.limits) for axis in machine.axes] == [
        ("pan", "position", (-2.6, 2.6)),
        ("lift", "position", (-0.5, 1.8)),
        ("elbow", "position", (-2.5, 0.5)),
    ]
    assert machine.tip == "grasp"
    effects = effects_of(machine)
    assert effects["input_delay", "elbow"] == {"delay": 0.01}
    assert effects["joint_compliance", "lift"]["compliance"] == pytest.approx(1.0 / 120.0, rel=1e-5)
    # A step of pan, which no gravity loads and whose inertia does not depend on its own angle.
    model = mujoco.MjModel.from_xml_path(str(robot("servo_arm")))
    model.dof_frictionloss[:] = 0.0
    model.actuator_forcelimited[:] = False
    data = mujoco.MjData(model)
    data.ctrl[0], angles = 0.2, []
    for _ in range(200):
        angles.append(float(data.joint("pan").qpos[0]))
        mujoco.mj_step(model, data)
    values = effects["second_order_lag", "pan"]
    omega, ratio = 1.0 / values["time_constant"], values["damping_ratio"]
    t, damped = 0.002 * np.arange(200), np.sqrt(1.0 - ratio**2) * omega
    expected = 0.2 * (1.0 - np.exp(-ratio * omega * t) * (np.cos(damped * t) + ratio * omega / damped * np.sin(damped * t)))
    assert np.sqrt(np.mean((np.array(angles) - expected) ** 2)) < 0.05 * 0.2


def test_motors_have_friction_and_rotors(tmp_path: Path) -> None:
    machine = drafted(tmp_path, robot("torque_arm"))
    assert [axis.actuation for axis in machine.axes] == ["force", "force"]
    assert [axis.inertia for axis in machine.axes] == [0.05, None]
    assert effects_of(machine) == {
        ("viscous_friction", "shoulder"): {"coefficient": 0.8},
        ("coulomb_friction", "shoulder"): {"force": 0.5},
        ("viscous_friction", "elbow"): {"coefficient": 0.3},
        ("coulomb_friction", "elbow"): {"force": 0.2},
    }


def test_speeds_are_those_at_full_control(tmp_path: Path) -> None:
    machine = drafted(tmp_path, robot("velocity_crane"), "--tip", "boom_tip", "--tool", "hook")
    assert [(axis.actuation, axis.gain) for axis in machine.axes] == [("velocity", 0.5), ("velocity", 0.3), ("velocity", 0.4)]
    assert (machine.tip, machine.tool) == ("jib", "hook"), "the site lies at the origin of its body"
    effects = effects_of(machine)
    # The position loop behind the integrated speed has the damping 6000 on the stiffness 150000 and resonates above 0.6.
    assert effects["first_order_lag", "luff"]["time_constant"] == pytest.approx(0.04, rel=1e-3)
    model = mujoco.MjModel.from_xml_path(str(robot("velocity_crane")))
    assert effects["first_order_lag", "reach"]["time_constant"] == pytest.approx(model.dof_M0[2] / 2000.0, rel=1e-5)


@pytest.mark.parametrize("name", [*ROBOTS, "odd"])
def test_a_drafted_machine_compiles(name: str, tmp_path: Path) -> None:
    compile_plant(nominal_plant(drafted(tmp_path, sources(tmp_path)[name])))


ARM = """<mujoco><worldbody><body name="a">{first}<geom size=".1"/>
<body name="b" pos="1 0 0"><joint name="k" {kind}/><geom size=".1"/>{end}</body></body></worldbody>{rest}</mujoco>"""
MOTORS = '<actuator><motor name="mj" joint="j"/><motor name="mk" joint="k"/></actuator>'
MOTOR_J, MOTOR_K = '<actuator><motor joint="j"/></actuator>', '<actuator><motor joint="k"/></actuator>'


def arm(
    rest: str = "",
    first: str = '<joint name="j" range="-90 90"/>',
    kind: str = 'range="-90 90"',
    end: str = "",
    motors: str = MOTORS,
) -> str:
    """An arm of two links; ``rest`` and ``motors`` follow the bodies."""
    return ARM.format(first=first, kind=kind, end=end, rest=rest + motors)


def motors(*names: str) -> str:
    """Actuators: ``kind joint name``."""
    elements = ['<{} joint="{}" name="{}"/>'.format(*name.split()) for name in names]
    return f"<actuator>{''.join(elements)}</actuator>"


TENDON = '<tendon><fixed name="t"><joint joint="j" coef="1"/><joint joint="k" coef="1"/></fixed></tendon>'
PULLED = '<actuator><motor joint="j"/><motor joint="k"/><motor name="p" tendon="t"/></actuator>'
LOOP = '<equality><connect body1="b" body2="world" anchor="0 0 0"/></equality>'
CURVE = '<equality><joint joint1="k" joint2="j" polycoef="0 1 2 0 0"/></equality>'
VOLTAGE = '<actuator><motor joint="j"/><dcmotor joint="k" motorconst="1 1" resistance="1"/></actuator>'

WRONG = {
    "free": (arm(first='<freejoint name="f"/>', motors=MOTOR_K), ("joint 'f' is free", "Add --base a --tip b.")),
    "ball": (arm(kind='type="ball"', motors=MOTOR_J), ("joint 'k' is a ball joint", "Add --tip a, which is in front of it")),
    "two actuators": (
        arm(motors=motors("motor j x", "velocity j y", "motor k z")),
        ("2 actuators: x and y", "one actuator a joint"),
    ),
    "passive": (arm(motors=MOTOR_K), ("no actuator drives joint 'j'", "Add --base a --tip b.")),
    "tendon": (arm(TENDON, motors=PULLED), ("'p'", "pulls a tendon across j and k", "an actuator on each joint")),
    "loop": (arm(LOOP), ("closed loop across j and k", "b and the world")),
    "muscle": (arm(motors=motors("muscle j x", "motor k z")), ("gain type muscle",)),
    "voltage": (arm(motors=VOLTAGE), ("gain type dcmotor",)),
    "gravity": (arm('<option gravity="9.81 0 0"/>'), ("gravity [9.81, 0.0, 0.0]", "z points up")),
    "curve": (arm(CURVE, motors=MOTOR_J), ("straight line",)),
    "nothing": ("<mujoco><worldbody><geom size='.1'/></worldbody></mujoco>", ("no joint that moves by itself",)),
    "cut off": ("<mujoco><worldbody><body/></worldbody>", ("not readable as XML",)),
    "misspelt": ("<mujoco><worldbody><bdy/></worldbody></mujoco>", ("unrecognized element", "that MuJoCo compiles")),
    "another format": ("<sdf/>", ("root element 'sdf'", "<robot> (URDF) or <mujoco> (MJCF)")),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_cannot_be_expressed(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, message = WRONG[case]
    tip = ["--tip", "b"] if case == "ball" else []
    assert run("init", tmp_path / "mine", "--from", written(tmp_path, text), *tip) == 2
    said = " ".join(capsys.readouterr().err.split())
    for part in message:
        assert part in said
    assert not (tmp_path / "mine").exists(), "nothing is written before the description is understood"


def test_a_tip_behind_a_loop_or_a_ball_joint_is_left_out_of_the_chain(tmp_path: Path) -> None:
    text = arm(end='<body name="hung"><joint type="ball"/><geom size=".1"/></body>')
    machine = drafted(tmp_path, written(tmp_path, text))
    assert machine.tip == "b"


def test_two_arms_need_a_choice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = """<mujoco><worldbody><body name="l"><joint name="jl"/><geom size=".1"/></body>
    <body name="r"><joint name="jr"/><geom size=".1"/></body></worldbody>
    <actuator><motor joint="jl"/><motor joint="jr"/></actuator></mujoco>"""
    path = written(tmp_path, text)
    assert run("init", tmp_path / "mine", "--from", path) == 2
    assert "2 chains of 1 driven joints, to l and r; expected one machine: a chain of joints. Add --tip l." in " ".join(
        capsys.readouterr().err.split()
    )
    machine = drafted(tmp_path, path, "--tip", "r")
    assert machine.axis_names == ("jr",)


def test_a_coupled_joint_is_passive(tmp_path: Path) -> None:
    coupled = '<equality><joint joint1="k" joint2="j" polycoef="0.2 -0.5 0 0 0"/></equality>'
    machine = drafted(tmp_path, written(tmp_path, arm(coupled, motors=MOTOR_J)))
    assert machine.tip == "b"
    kinematics = machine.kinematics()
    assert kinematics is not None
    drive = kinematics.drives["k"]
    assert (drive.ratio, drive.offset) == (-0.5, 0.2)


URDF = """<robot name="r"><link name="base"/><link name="arm"/><link name="hand"><inertial><mass value="1"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="2" effort="1" velocity="1.5"/><dynamics damping="0.4" friction="0.1"/></joint>
<joint name="push/pull" type="prismatic"><parent link="arm"/><child link="hand"/><axis xyz="1 0 0"/>
<limit lower="0" upper="0.5" effort="1" velocity="0.2"/></joint>{rest}</robot>"""
INTERFACE = '<joint name="{}"><command_interface name="{{}}"/></joint>'
CONTROL = f'<ros2_control name="c">{INTERFACE.format("turn")}{INTERFACE.format("push/pull")}</ros2_control>'


def test_a_urdf_states_its_interfaces(tmp_path: Path) -> None:
    machine = drafted(tmp_path, written(tmp_path, URDF.format(rest=CONTROL.format("effort", "velocity"))))
    assert [(axis.name, axis.actuation, axis.gain) for axis in machine.axes] == [
        ("turn", "force", 1.0),
        ("push_pull", "velocity", 0.2),
    ]
    assert effects_of(machine) == {
        ("viscous_friction", "turn"): {"coefficient": 0.4},
        ("coulomb_friction", "turn"): {"force": 0.1},
    }
    assert machine.tip == "hand"
    interface = "<hardwareInterface>hardware_interface/{}JointInterface</hardwareInterface>"
    transmission = f'<transmission><joint name="{{}}">{interface}</joint></transmission>'
    rest = transmission.format("turn", "Effort") + transmission.format("push/pull", "Position")
    (tmp_path / "second").mkdir()
    machine = drafted(tmp_path / "second", written(tmp_path, URDF.format(rest=rest)))
    assert [axis.actuation for axis in machine.axes] == ["force", "position"]


def test_a_urdf_without_interfaces_needs_a_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, URDF.format(rest=""))
    assert run("init", tmp_path / "mine", "--from", path) == 2
    assert "no <ros2_control> or <transmission> states how it is commanded" in " ".join(capsys.readouterr().err.split())
    machine = drafted(tmp_path, path, "--kind", "hydraulic", "--json", str(tmp_path / "made.json"))
    assert [axis.gain for axis in machine.axes] == [1.5, 0.2]
    assert json.loads((tmp_path / "made.json").read_text())["left_out"] == [
        "force limit 1 N·m of turn",
        "damping inside the control loop of turn",
        "friction inside the control loop of turn",
        "force limit 1 N of push/pull",
    ]


@pytest.mark.parametrize("name", ["ur10", "tiago"])
def test_urdfs_of_the_shipped_machines(name: str, datasets_folder: Path, tmp_path: Path) -> None:
    shipped = load_machine(datasets_folder / name / "machine.toml")
    machine = drafted(tmp_path, datasets_folder / name / "arm.urdf", "--kind", "servo", "--tip", str(shipped.tip))
    assert {axis.joint for axis in shipped.axes} <= {axis.joint for axis in machine.axes}


GEAR = """<mujoco><compiler angle="radian"/><worldbody><body>
<joint name="elbow" axis="0 1 0" range="-1 1" armature="0.01"/>{joint}
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5"/></body></worldbody>
<actuator><position joint="elbow" kp="20" kv="1"/>{actuator}</actuator></mujoco>"""
BEHIND = '<joint name="gear" axis="{axis}" range="{range}" limited="true" {more}/>'


@pytest.mark.parametrize("half", [0.001, 0.02, 0.05])
def test_a_joint_between_two_ends_behind_a_driven_one_is_its_backlash(tmp_path: Path, half: float) -> None:
    joint = BEHIND.format(axis="0 1 0", range=f"-{half} {half}", more="")
    machine = drafted(tmp_path, written(tmp_path, GEAR.format(joint=joint, actuator="")))
    assert machine.axis_names == ("elbow",)
    assert effects_of(machine)["backlash", "elbow"] == {"width": pytest.approx(2.0 * half)}


@pytest.mark.parametrize(
    ("axis", "ends", "more", "actuator"),
    [
        ("0 0 1", "-0.02 0.02", "", ""),
        ("0 1 0", "-0.2 0.2", "", ""),
        ("0 1 0", "-0.02 0.01", "", ""),
        ("0 1 0", "-0.02 0.02", 'stiffness="10"', ""),
        ("0 1 0", "-0.02 0.02", "", '<position joint="gear" kp="20"/>'),
    ],
    ids=["another axis", "wide", "to one side", "a spring", "driven"],
)
def test_other_second_joints_are_joints(tmp_path: Path, axis: str, ends: str, more: str, actuator: str) -> None:
    joint = BEHIND.format(axis=axis, range=ends, more=more)
    source = written(tmp_path, GEAR.format(joint=joint, actuator=actuator))
    machine = drafted(tmp_path, source, *([] if actuator else ["--kind", "servo"]))
    assert machine.axis_names == ("elbow", "gear")
    assert not [effect for effect in machine.effects if effect.name == "backlash"]
