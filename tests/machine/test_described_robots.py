"""Robot descriptions of others: what has no meaning is not read, what cannot be expressed is refused with a working remedy."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import mujoco
import numpy as np
import pytest
from command_line import run
from hypothesis import given
from hypothesis import strategies as st

from sysid.errors import SettingsError
from sysid.machine import Machine, load_machine
from sysid.machine.kinematics import Kinematics
from sysid.machine.rigid_body import RigidBody, rigid_body
from sysid.machine.urdf_tree import urdf_tree

BODY = '<inertial><origin xyz="0.1 0 0.02"/><mass value="{}"/>'
BODY += '<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>'
LIMIT = '<limit lower="-1" upper="2" effort="87" velocity="2.5"/>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = LIMIT, axis: str = "0 1 0") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.3 0 0.1" rpy="0.1 0 0.2"/><axis xyz="{axis}"/>{inside}</joint>'
    )


def arm(*more: str, second: str = "", inertial: str = BODY.format(1.0)) -> str:
    """Two revolute joints ``j1`` and ``j2``, links ``base``, ``l1``, ``l2``."""
    links = f'<link name="base"/><link name="l1">{BODY.format(2.0)}</link><link name="l2">{inertial}</link>'
    second = second or joint("j2", "l1", "l2")
    return f'<robot name="r">{links}{joint("j1", "base", "l1", axis="0 0 1")}{second}{"".join(more)}</robot>'


def written(folder: Path, text: str) -> Path:
    path = folder / ("robot.xml" if text.startswith("<mujoco") else "robot.urdf")
    path.write_text(text, "utf-8")
    return path


def drafted(folder: Path, text: str, *options: str) -> Machine:
    assert run("init", folder / "mine", "--name", "mine", "--from", written(folder, text), *options) == 0
    return load_machine(folder / "mine/datasets/mine/machine.toml")


def refusal(folder: Path, text: str, capsys: pytest.CaptureFixture[str], *options: str) -> str:
    """The paragraph with which a description is refused."""
    capsys.readouterr()
    assert run("init", folder / "mine", "--name", "mine", "--from", written(folder, text), *options) == 2
    assert not (folder / "mine").exists()
    return " ".join(capsys.readouterr().err.split())


def followed(folder: Path, text: str, capsys: pytest.CaptureFixture[str], *options: str) -> Machine:
    """The machine after the options of the remedy were added literally, once."""
    found = re.search(r"Add ((?:--\w+ (?:'[^']*'|\S+?)(?: (?=--)|\.))+)", refusal(folder, text, capsys, *options))
    assert found is not None
    return drafted(folder, text, *options, *shlex.split(found[1].removesuffix(".")))


def tips(urdf: str, joints: tuple[str, ...] = ("j1", "j2"), tip: str = "l2") -> np.ndarray:
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, len(joints)))
    return Kinematics.from_urdf(urdf, joints, tip).tip_position(q)


FIXED = '<link name="cam"/>' + joint("cam_joint", "l1", "cam", "fixed", "{}", "{}")
MEANINGLESS = {
    "axis of a fixed joint": FIXED.format("0 0 0", ""),
    "no number in the axis of a fixed joint": FIXED.format("nan nan nan", ""),
    "limits of a fixed joint": FIXED.format("1 0 0", '<limit lower="3" upper="1" effort="-1" velocity="x"/>'),
    "mimic of a fixed joint": FIXED.format("1 0 0", '<mimic joint="nobody"/>'),
    "dynamics of a fixed joint": FIXED.format("1 0 0", '<dynamics damping="-1"/>'),
    "mimic of nothing beside the chain": '<link name="cam"/>' + joint("cam_joint", "l1", "cam", inside='<mimic joint="no"/>'),
    "floating beside the chain": '<link name="cam"/>' + joint("cam_joint", "l1", "cam", "floating", ""),
    "planar beside the chain": '<link name="cam"/>' + joint("cam_joint", "l1", "cam", "planar", ""),
    "no range beside the chain": '<link name="cam"/>'
    + joint("cam_joint", "base", "cam", inside='<limit lower="0" upper="0"/>'),
    "undeclared prefix": '<drake:group name="g"><drake:member link="l1"/></drake:group><gazebo:x a:b="c"/>',
    "joint and link of one name": '<link name="j1"/>' + joint("base", "l1", "j1", "fixed"),
    "names of the library": '<link name="universe"/>' + joint("root_joint", "l1", "universe", "fixed"),
}


@pytest.mark.parametrize("case", MEANINGLESS)
def test_what_has_no_meaning_changes_nothing(case: str, tmp_path: Path) -> None:
    machine = drafted(tmp_path, arm(MEANINGLESS[case]), "--kind", "force", "--tip", "l2")
    assert machine.axis_names == ("j1", "j2")
    assert machine.urdf_text is not None
    np.testing.assert_array_equal(tips(machine.urdf_text), tips(arm()))
    body, plain = rigid_body(machine), RigidBody(Kinematics.from_urdf(arm(), ("j1", "j2"), "l2"), arm())
    assert body is not None
    q, v, a = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 4, 2))
    np.testing.assert_allclose(body.torque(q, v, a, body.nominal), plain.torque(q, v, a, plain.nominal), rtol=1e-12)


REFUSED = {
    "axis of length zero": (arm(second=joint("j2", "l1", "l2", axis="0 0 0")), ("joint 'j2'", "length zero", 'xyz="0 0 1"')),
    "two roots": (arm('<link name="cam_base"/><link name="cam"/>', joint("c", "cam_base", "cam", "fixed")),
                  ("2 links without a parent: 'base' and 'cam_base'", "fixed joints")),
    "a loose link": (arm('<link name="free"/>'), ("'base' and 'free'",)),
    "a missing parent": (arm(joint("j3", "nobody", "l2")), ("joint 'j3'", "parent link 'nobody'", '<link name="nobody"/>')),
    "a missing child": (arm(joint("j3", "l2", "nobody")), ("joint 'j3'", "child link 'nobody'", "remove the joint")),
    "equal limits": (arm(second=joint("j2", "l1", "l2", inside='<limit lower="0" upper="0"/>')),
                     ("joint 'j2'", "continuous", "state lower and upper")),
    "reversed limits": (arm(second=joint("j2", "l1", "l2", inside='<limit lower="1" upper="-1"/>')), ("Swap lower and upper",)),
    "a comma": (arm(second=joint("j2", "l1", "l2", axis="0, 1 0")), ("joint 'j2'", 'Write xyz="0 1 0"')),
    "no number": (arm(second=joint("j2", "l1", "l2", inside='<limit lower="nan" upper="1"/>')), ("joint 'j2'", "lower='nan'")),
    "a xacro element": (arm('<xacro:include filename="x.xacro"/>'), ("<xacro:include>", "xacro FILE > robot.urdf")),
    "a xacro expression": (arm(second=joint("j2", "l1", "l2", inside='<limit lower="${-pi}" upper="1"/>')),
                           ("joint 'j2'", "xacro FILE > robot.urdf")),
    "a negative mass": (arm(inertial=BODY.format(-1.0)), ("link 'l2'", "value='-1.0'")),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_a_refusal_names_place_and_remedy(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, parts = REFUSED[case]
    said = refusal(tmp_path, text, capsys, "--kind", "servo")
    for part in parts:
        assert part in said


def test_a_floating_joint_on_the_chain_is_no_axis() -> None:
    text = arm(second=joint("j2", "l1", "l2", "floating"))
    with pytest.raises(SettingsError, match=r"joint 'j2': a floating joint, which moves the tip; .* Change its type to fixed"):
        Kinematics.from_urdf(text, ("j1",), "l2")


@pytest.mark.parametrize(
    ("limit", "expected"),
    [
        ('lower="-1e16" upper="1e16"', (-6.283, 6.283)),
        ('lower="-inf" upper="inf"', (-6.283, 6.283)),
        ('lower="-1.5" upper="inf"', (-1.5, 6.283)),
        ('lower="-1e300" upper="0.5"', (-6.283, 0.5)),
        ('lower="-1.5" upper="0.5"', (-1.5, 0.5)),
    ],
)
def test_end_stops_beyond_any_machine_are_none(
    limit: str, expected: tuple[float, float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = arm(second=joint("j2", "l1", "l2", inside=f"<limit {limit}/>"))
    machine = drafted(tmp_path, text, "--kind", "servo")
    assert machine.axis("j2").limits == expected
    assert ("assumed: end stops of j2" in " ".join(capsys.readouterr().out.split())) == (6.283 in np.abs(expected))


def moments(xx: float, yy: float, zz: float, xy: float = 0.0) -> str:
    return f'<inertial><mass value="1"/><inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="{xy}" ixz="0" iyz="0"/></inertial>'


@pytest.mark.parametrize("case", [(-5.42e-20, 0.0, 0.0), (0.02, 0.02, -1e-12), (1.0, -1e-8, 1.0)])
def test_a_rounded_moment_is_accepted(case: tuple[float, float, float], tmp_path: Path) -> None:
    drafted(tmp_path, arm(inertial=moments(*case)), "--kind", "force")


@pytest.mark.parametrize("case", [(-0.01, 0.02, 0.02), (0.01, 0.01, 0.02, 0.05)])
def test_an_indefinite_inertia_is_refused_where_it_counts(
    case: tuple[float, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refusal(tmp_path, arm(inertial=moments(*case)), capsys, "--kind", "force")
    assert "link 'l2': inertia: a negative principal moment" in said
    assert "all six moments 0 is a point mass" in said
    machine = drafted(tmp_path, arm(inertial=moments(*case)), "--kind", "servo")
    assert machine.left_out[-1] == "inertia with a negative principal moment, which no body has, of l2"


@given(st.integers(0, 2**32 - 1))
def test_a_random_tree_reads_as_without_its_meaningless_data(seed: int) -> None:
    """Fixed joints anywhere, with any axis, mimic and limits: kinematics and torques are those of the plain tree."""
    rng = np.random.default_rng(seed)
    parts, plain, moving = ['<link name="k0"/>'], ['<link name="k0"/>'], []
    for k in range(1, int(rng.integers(3, 8))):
        parent = f"k{rng.integers(max(0, k - 2), k)}"
        link = f'<link name="k{k}">{BODY.format(0.5 + k)}</link>'
        if rng.random() < 0.5 or k == 1:
            moving.append(f"k{k}")
            its = joint(f"k{k}", parent, f"k{k}")
            parts.append(link + its)
            plain.append(link + its)
        else:
            axis = " ".join(rng.choice(["0", "nan", "1e30"], 3))
            inside = str(rng.choice(['<mimic joint="k1" multiplier="x"/>', '<limit lower="inf"/>', '<dynamics friction="?"/>']))
            parts.append(link + joint(f"k{k}", parent, f"k{k}", "fixed", inside, axis))
            plain.append(link + joint(f"k{k}", parent, f"k{k}", "fixed", ""))
    texts = [f'<robot name="r">{"".join(each)}</robot>' for each in (parts, plain)]
    trees = [urdf_tree(text) for text in texts]
    assert len(trees[0].findall("joint")) == len(trees[1].findall("joint"))
    tip, joints = moving[-1], list[str]()
    by_child = {f"k{k}": text for k, text in enumerate(plain)}
    at = tip
    while at != "k0":
        joints += [at] if 'type="revolute"' in by_child[at] else []
        at = re.search(r'parent link="(\w+)"', by_child[at])[1]  # type: ignore[index]
    names = tuple(reversed(joints))
    q, v, a = rng.uniform(-1.0, 1.0, (3, 3, len(names)))
    bodies = [RigidBody(Kinematics.from_urdf(text, names, tip), text) for text in texts]
    found = [body.torque(q, v, a, body.nominal) for body in bodies]
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12, atol=1e-12)


HAND = '<link name="f1"/><link name="f2"/>' + joint("g1", "l2", "f1", "prismatic") + joint("g2", "l2", "f2", "prismatic")
LEGS = '<link name="m1"/><link name="m2"/>' + joint("i1", "base", "m1") + joint("i2", "m1", "m2")
STATED = "<ros2_control>{}</ros2_control>".format(
    "".join(f'<joint name="{name}"><command_interface name="position"/></joint>' for name in ("j1", "j2", "g1", "g2"))
)


def test_the_obvious_arm_ends_before_its_fingers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = drafted(tmp_path, arm(HAND, STATED))
    assert (machine.axis_names, machine.tip) == (("j1", "j2"), "l2")
    out = " ".join(capsys.readouterr().out.split())
    assert "assumed: end effector l2: the chain parts to f1 and f2; --tip chooses another" in out
    assert "left out: joints beside the chain to l2, which rest at zero: g1 and g2" in out


def test_of_two_chains_the_remedy_takes_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = followed(tmp_path, arm(LEGS), capsys)
    assert (machine.axis_names, machine.tip) == (("j1", "j2"), "l2")


def test_a_chain_that_cannot_be_read_is_not_proposed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = joint("j2", "l1", "l2", inside='<limit lower="0" upper="0"/>')
    assert followed(tmp_path, arm(LEGS, second=bad), capsys).tip == "m2"


def test_kinds_that_do_not_fit_are_not_proposed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    slow = joint("j2", "l1", "l2", inside='<limit lower="-1" upper="1" velocity="0"/>')
    said = refusal(tmp_path, arm(second=slow), capsys)
    assert "hydraulic" not in said
    assert followed(tmp_path, arm(second=slow), capsys).axis("j2").actuation == "position"


def test_a_floating_base_is_held_still(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = arm().replace("<robot", "<robot", 1).replace('<link name="base"/>', '<link name="w"/><link name="base"/>')
    text = text.replace("</robot>", joint("float", "w", "base", "floating", "") + "</robot>")
    machine = followed(tmp_path, text, capsys)
    assert machine.axis_names == ("j1", "j2")
    kinematics = machine.kinematics()
    assert kinematics is not None
    assert kinematics.chain[0].parent == "w"


def test_limits_of_force_and_speed_are_told_to_the_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = drafted(tmp_path, arm(), "--kind", "servo")
    assert machine.left_out == ("force limit 87 N·m of j1 and j2", "speed limit 2.5 rad/s of j1 and j2")


GRAVITY = "<option>{}</option>"
MJCF = """<mujoco><compiler angle="radian"/>{option}<worldbody><body name="upper" pos="0 0 0.5">
<joint name="shoulder" axis="0 -1 0" range="-1.5 1.5" damping="0.2" armature="0.03" frictionloss="0.05"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.8" contype="0" conaffinity="0"/>
<body name="fore" pos="0.3 0 0"><joint name="elbow" axis="0 -1 0" range="-2 2" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.015" mass="0.4" contype="0" conaffinity="0"/>
<site name="tip" pos="0.25 0 0"/>{end}</body></body></worldbody>{rest}</mujoco>"""
MOTORS = '<actuator><motor name="s" joint="shoulder"/><motor name="e" joint="elbow"/></actuator>'
SERVOS = '<actuator><position name="s" joint="shoulder" kp="{}" kv="{}"/>'
SERVOS += '<position name="e" joint="elbow" kp="40" kv="2"/></actuator>'


def flagged(flag: str, drive: str = MOTORS, end: str = "") -> str:
    return MJCF.format(option=f'<option><flag {flag}="disable"/></option>' if flag else "", rest=drive, end=end)


def test_no_gravity_is_refused_for_forces_and_noted_for_servos(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refusal(tmp_path, flagged("gravity"), capsys)
    assert 'no gravity (<flag gravity="disable">)' in said
    assert 'Remove <flag gravity="disable">' in said
    machine = drafted(tmp_path, flagged("gravity", SERVOS.format(80, 4)))
    assert "joint_compliance" not in {effect.name for effect in machine.effects}
    assert any(line.startswith("no gravity") for line in machine.left_out)


@pytest.mark.parametrize("gravity", ["0 0 0", "0 0 -981", "9.81 0 0", "0 0 9.81"])
def test_another_gravity_is_never_taken_for_ours(gravity: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    option = f'<option gravity="{gravity}"/>'
    assert 'Write <option gravity="0 0 -9.81">' in refusal(tmp_path, MJCF.format(option=option, rest=MOTORS, end=""), capsys)
    machine = drafted(tmp_path, MJCF.format(option=option, rest=SERVOS.format(80, 4), end=""))
    assert any(line.startswith("gravity [") for line in machine.left_out)


@pytest.mark.parametrize("gravity", [1.62, 3.7, 9.80665, 9.81])
def test_the_gravity_of_a_model_is_that_of_the_machine(gravity: float, tmp_path: Path) -> None:
    text = MJCF.format(option=f'<option gravity="0 0 {-gravity}"/>', rest=MOTORS, end="")
    machine, model = drafted(tmp_path, text), mujoco.MjModel.from_xml_string(text)
    assert machine.gravity == gravity
    data, body = mujoco.MjData(model), rigid_body(machine)
    assert body is not None
    data.qpos[:] = 0.4, -0.7
    mujoco.mj_inverse(model, data)
    still = np.zeros((1, 2))
    np.testing.assert_allclose(body.torque(data.qpos[None], still, still, body.nominal)[0], data.qfrc_inverse, rtol=1e-9)


@pytest.mark.parametrize(
    ("flag", "gone"),
    [("damper", "viscous_friction"), ("frictionloss", "coulomb_friction"), ("constraint", "coulomb_friction")],
)
def test_what_a_flag_switches_off_is_not_in_the_machine(flag: str, gone: str, tmp_path: Path) -> None:
    names = {effect.name for effect in drafted(tmp_path, flagged(flag)).effects}
    assert names == {"viscous_friction", "coulomb_friction"} - {gone}


@pytest.mark.parametrize("flag", ["", "damper", "frictionloss", "constraint", "limit", "spring"])
def test_the_torque_of_a_flagged_model_is_that_of_the_machine(flag: str, tmp_path: Path) -> None:
    """Inverse dynamics of MuJoCo beside masses and friction of the machine, at its gravity."""
    text = flagged(flag)
    machine = drafted(tmp_path, text)
    body = rigid_body(machine)
    assert body is not None
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    effects = {(effect.name, effect.target): effect.parameters for effect in machine.effects}
    q, v, a = np.array([0.4, -0.7]), np.array([0.8, -0.5]), np.array([1.0, 2.0])
    data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
    mujoco.mj_inverse(model, data)
    ours = body.torque(q[None], v[None], a[None], body.nominal)[0]
    for k, axis in enumerate(machine.axes):
        ours[k] += (axis.inertia or 0.0) * a[k]
        viscous = effects.get(("viscous_friction", axis.name), {}).get("coefficient", 0.0)
        ours[k] += float(np.asarray(viscous)) * v[k]
    # dry friction is a constraint of MuJoCo: its force is part of qfrc_constraint
    np.testing.assert_allclose(ours, data.qfrc_inverse + data.qfrc_constraint, rtol=1e-9)


@pytest.mark.parametrize(("kp", "kv"), [(1, 5), (0.01, 1)])
def test_a_servo_slower_than_any_lag_is_noted(kp: float, kv: float, tmp_path: Path) -> None:
    machine = drafted(tmp_path, flagged("", SERVOS.format(kp, kv)), "--kind", "response")
    assert ("first_order_lag", "shoulder") not in {(effect.name, effect.target) for effect in machine.effects}
    assert any(line.startswith("first_order_lag of shoulder: time_constant") for line in machine.left_out)


def test_a_passive_joint_behind_the_chain_is_noted(tmp_path: Path) -> None:
    pole = '<body name="pole" pos="0.25 0 0"><joint name="swing" axis="0 1 0"/><geom size=".02" mass="1"/></body>'
    machine = drafted(tmp_path, flagged("", end=pole))
    assert machine.left_out == ("joints beside or behind the chain, which are rigid at their reference: swing",)


def test_a_coupling_of_two_driven_joints_is_noted(tmp_path: Path) -> None:
    coupled = '<equality><joint joint1="elbow" joint2="shoulder" polycoef="0 1 0 0 0"/></equality>'
    assert drafted(tmp_path, flagged("", MOTORS + coupled)).left_out == ("coupling of two driven joints: elbow and shoulder",)


def test_joints_without_actuators_take_the_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = followed(tmp_path, flagged("", ""), capsys)
    assert [axis.actuation for axis in machine.axes] == ["position", "position"]
    again = tmp_path / "again"
    again.mkdir()
    machine = drafted(again, flagged("", ""), "--kind", "force")
    effects = {(effect.name, effect.target): effect.parameters for effect in machine.effects}
    assert effects["viscous_friction", "shoulder"] == {"coefficient": 0.2}
    assert effects["coulomb_friction", "shoulder"] == {"force": 0.05}
    assert machine.axis("shoulder").inertia == 0.03


def test_a_base_on_a_free_joint_is_held_where_the_model_has_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = flagged("").replace('<body name="upper" pos="0 0 0.5">', '<body name="root" pos="0.1 0.2 0.7" euler="0.3 0 0.5">'
                               '<freejoint/><geom size=".1"/><body name="upper" pos="0 0 0.5">')  # fmt: skip
    text = text.replace("</worldbody>", "</body></worldbody>")
    machine = followed(tmp_path, text, capsys)
    kinematics = machine.kinematics()
    assert kinematics is not None
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for q in np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2)):
        data.qpos[7:] = q
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(kinematics.tip_position(q)[0], data.site("tip").xpos, atol=1e-9)


def test_a_servo_may_have_a_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scaled = '<actuator><general name="s" joint="shoulder" gainprm="500" biastype="affine" biasprm="0 -200 -10"/>'
    machine = drafted(tmp_path, flagged("", f'{scaled}<motor joint="elbow" gear="20"/></actuator>'))
    assert machine.axis("shoulder").actuation == "position"
    out = " ".join(capsys.readouterr().out.split())
    assert "assumed: command of shoulder in rad: the control of s is 0.4 times that" in out
    assert "assumed: command of elbow in N·m: the control of actuator_1 is 0.05 times that" in out


SHAPES = (
    "<sphere/>",
    '<sphere radius="0.00"/>',
    '<box size="1 1"/>',
    '<cylinder radius="1" length="-1"/>',
    '<mesh scale="x"/>',
)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_shape_without_an_extent_is_left_out(shape: str, tmp_path: Path) -> None:
    visual = f'<collision><geometry>{shape}</geometry></collision><visual><geometry><sphere radius="1"/></geometry></visual>'
    machine = drafted(tmp_path, arm(inertial=BODY.format(1.0) + visual), "--kind", "servo")
    assert machine.left_out[-1] == "shapes without an extent of l2"
    assert machine.urdf_text is not None
    assert [len(urdf_tree(machine.urdf_text).findall(f"link/{kind}")) for kind in ("collision", "visual")] == [0, 1]


def test_limits_of_controls_are_told(tmp_path: Path) -> None:
    drives = """<actuator><position name="s" joint="shoulder" kp="80" kv="4" ctrlrange="-0.5 1.5"/>
    <motor name="e" joint="elbow" gear="20" ctrlrange="-1 1" forcerange="-2 2"/></actuator>"""
    held = '<equality><joint joint1="elbow" polycoef="0.5 0 0 0 0"/></equality>'
    assert drafted(tmp_path, flagged("", drives + held)).left_out == (
        "controllers of shoulder, which are described by their responses: elbow has no position actuator",
        "setpoint limit -0.5 to 1.5 rad of shoulder",
        "friction loss inside the control loop of shoulder",
        "force limit 20 N·m of elbow",
        "equality that holds elbow",
    )


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "iso-8859-1", "utf-16", "windows-1252"])
def test_an_encoding_is_read_as_declared(encoding: str, tmp_path: Path) -> None:
    stated = encoding.removesuffix("-sig")
    for k, text in enumerate((arm().replace('name="r"', 'name="Straße"'), flagged(""))):
        path = tmp_path / f"robot{k}"
        path.write_bytes(f'<?xml version="1.0" encoding="{stated}"?>\n<!-- Prüfstand -->{text}'.encode(encoding))
        kind = ("--kind", "servo") if k == 0 else ()
        assert run("init", tmp_path / f"mine{k}", "--name", "mine", "--from", path, *kind) == 0


def test_another_encoding_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "robot.urdf"
    for content in (b'<?xml version="1.0" encoding="ebcdic"?><robot/>', b"<robot name='\xff'/>"):
        path.write_bytes(content)
        assert run("init", tmp_path / "mine", "--name", "mine", "--from", path) == 2
        assert "Save it as UTF-8." in " ".join(capsys.readouterr().err.split())


def test_names_that_give_one_axis_name_are_numbered(tmp_path: Path) -> None:
    text = arm().replace('"j1"', '"a/b"').replace('"j2"', '"a b"')
    assert drafted(tmp_path, text, "--kind", "servo").axis_names == ("a_b", "a_b_2")


def test_left_out_is_in_the_json_of_init(tmp_path: Path) -> None:
    drafted(tmp_path, arm(), "--kind", "servo", "--json", str(tmp_path / "made.json"))
    made = json.loads((tmp_path / "made.json").read_text())
    assert made["left_out"][0].startswith("force limit 87 N·m of j1")
    assert made["assumed"] == []
