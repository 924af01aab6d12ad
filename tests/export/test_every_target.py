"""Machines of every kind × targets: written, read again by the simulator of the target, and replayed as the plant."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from command_line import run
from robots import robot
from test_mjcf_arm import dataset as arm_dataset
from test_sdf import place_of

from sysid.datasets.recording import Dataset, Recording
from sysid.errors import SettingsError
from sysid.export.export import TARGETS, Export, export_plant, target_named
from sysid.export.mjcf_servo import has_servos
from sysid.export.page import lacking
from sysid.export.sdf import FILE as SDF_FILE
from sysid.export.target import Target
from sysid.export.urdf import END_EFFECTOR
from sysid.machine import KnownEffect, load_machine, machine_from_files
from sysid.machine.rigid_body import moves_masses
from sysid.machine.urdf_tree import urdf_tree
from sysid.plant import Plant, nominal_plant
from sysid.plant.stepper import Stepper

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")
Array = npt.NDArray[np.float64]
RATE, SECONDS = 100.0, 1.5
#: A solid ball.
MASS = '<inertial><mass value="1.5"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'


def link(name: str, inside: str = "") -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(name: str, kind: str, ends: tuple[str, str], xyz: str = "0 0 0", axis: str = "0 0 1", inside: str = "") -> str:
    moves = "" if kind in ("fixed", "floating") else f'<axis xyz="{axis}"/>'
    stops = '<limit lower="-2" upper="2" effort="9" velocity="3"/>' if kind in ("revolute", "prismatic") else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{ends[0]}"/><child link="{ends[1]}"/>'
        f'<origin xyz="{xyz}" rpy="0.1 0 0.2"/>{moves}{stops}{inside}</joint>'
    )


def plant_of(
    axes: Sequence[dict[str, Any]],
    urdf: str = "",
    effects: Sequence[KnownEffect] = (),
    name: str = "m",
    **points: str,
) -> Plant:
    """A machine of these axes, ``name``, ``joint``, ``actuation`` and more, all driven at their joints.

    Args:
        points: links of the ``tip``, if it is not one of that name, and of the ``tool``.
    """
    head = {"schema": 1, "name": name, "rate_hz": RATE}
    if urdf:
        head |= {"urdf": "m.urdf", "tip": "tip"} | points
    tables = [head, *({"drives": "joint"} | axis for axis in axes)]
    texts = ("\n".join(f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in t.items()) for t in tables)
    text = "\n[[axes]]\n".join(texts)
    files = {"machine.toml": text} | ({"m.urdf": f'<robot name="m">{urdf}</robot>'} if urdf else {})
    plant = nominal_plant(machine_from_files(files, "test"))
    for effect in effects:
        plant = plant.with_effect(effect)
    return plant


def two_axes(actuation: str, **more: Any) -> list[dict[str, Any]]:
    return [{"name": name, "joint": f"{name}_joint", "actuation": actuation} | more for name in ("base_turn", "lift")]


def chain(root: str = "base", kinds: tuple[str, str] = ("revolute", "revolute"), second: str = "0 1 0", mass: str = "") -> str:
    """Two links and a tip."""
    return (
        link(root) + link("upper", mass) + link("fore", mass) + link("tip")
        + joint("base_turn_joint", kinds[0], (root, "upper"), "0 0 0.3")
        + joint("lift_joint", kinds[1], ("upper", "fore"), "0.4 0 0.05", second)
        + joint("end", "fixed", ("fore", "tip"), "0.3 0.1 0")
    )  # fmt: skip


def servo() -> Plant:
    """As ``init --from`` writes the servo arm of an MJCF: its root link is ``world``."""
    lag = KnownEffect("second_order_lag", "lift", {"time_constant": 0.03, "damping_ratio": 0.7})
    return plant_of(two_axes("position"), chain("world", mass=MASS), [lag])


def valves() -> Plant:
    deadband = KnownEffect("valve_deadband", "lift", {"positive": 0.05, "negative": 0.08})
    lag = KnownEffect("first_order_lag", "base_turn", {"time_constant": 0.06})
    return plant_of(two_axes("velocity", gain=0.8), chain(), [deadband, lag])


def continuous() -> Plant:
    """A slew without end stops in its URDF."""
    axes = two_axes("velocity", gain=0.8)
    axes[0]["limits"] = [-100.0, 100.0]
    return plant_of(axes, chain(kinds=("continuous", "revolute")))


def sliding() -> Plant:
    axes = two_axes("force", inertia=2.0)
    friction = KnownEffect("viscous_friction", "lift", {"coefficient": 4.0})
    return plant_of(axes, chain(kinds=("prismatic", "prismatic")), [friction])


def planar() -> Plant:
    """All axes vertical: the height of the end effector is constant, and only rounding changes it."""
    return plant_of(two_axes("position"), chain(second="0 0 1").replace('rpy="0.1 0 0.2"', 'rpy="0 0 0.2"'))


def gripper() -> Plant:
    """Fingers beside the chain: one follows an axis, one a finger that no axis moves."""
    fingers = link("left") + link("right") + link("thumb")
    fingers += joint(
        "left_joint", "prismatic", ("fore", "left"), "0 0.1 0", inside='<mimic joint="lift_joint" multiplier="0.1"/>'
    )
    fingers += joint("right_joint", "revolute", ("fore", "right"), "0 -0.1 0")
    fingers += joint("thumb_joint", "revolute", ("fore", "thumb"), "0 0 0.1", inside='<mimic joint="right_joint"/>')
    return plant_of(two_axes("position"), chain() + fingers)


def linkage() -> Plant:
    """A passive joint on the chain, under the weight of the links behind it."""
    knee = joint("knee", "revolute", ("fore", "shin"), "0.3 0 0", "0 1 0", '<mimic joint="lift_joint" multiplier="-1.2"/>')
    links = chain(mass=MASS).replace('<parent link="fore"/>', '<parent link="shin"/>')
    return plant_of(two_axes("position"), links + link("shin", MASS) + knee)


def without_urdf() -> Plant:
    axes = two_axes("velocity", gain=0.5, joint_type="revolute", limits=[-2.0, 2.0])
    return plant_of([axes[0], axes[1] | {"joint_type": "prismatic"}])


MACHINES = {make.__name__: make for make in (servo, valves, continuous, sliding, planar, gripper, linkage, without_urdf)}


def recording(plant: Plant, name: str) -> Recording:
    """Waves of commands, and what the plant makes of them."""
    rate = plant.machine.rate_hz
    t, stepper = np.arange(round(SECONDS * rate)) / rate, Stepper(plant, rate)
    size, columns, start = {"velocity": 0.6, "force": 3.0}, [], []
    for k, axis in enumerate(plant.machine.axes):
        low, high = axis.limits or (-2.0, 2.0)
        start.append(min(max(0.0, low + 0.3 * (high - low)), high - 0.3 * (high - low)) if np.isfinite(high - low) else 0.0)
        wave = size.get(axis.actuation, min(0.5, 0.2 * (high - low))) * np.sin(2.0 * np.pi * (0.7 + 0.3 * k) * t)
        columns.append(start[k] + wave if axis.follows_positions else wave)
    commands = np.column_stack(columns)
    joints = [stepper.reset(np.array(start), commands=commands[0]).joints[0].copy()]
    joints += [stepper.step(command).joints[0].copy() for command in commands[1:]]
    table = {"time": t}
    for k, axis in enumerate(plant.machine.axis_names):
        table |= {f"{axis}.command": commands[:, k], f"{axis}.joint": np.array(joints)[:, k]}
    return Recording(name, pd.DataFrame(table), rate)


def exported(plant: Plant, target: Target, folder: Path, force: bool = False) -> Export:
    data = Dataset.of(plant.machine, [recording(plant, "r0")], {"r0": "held_out"})
    return export_plant(plant, data, target, folder / "out", force=force, samples=1)


def sdf_agrees(plant: Plant, folder: Path) -> None:
    """The end effector of the frames of the file alone, at joint values of the plant."""
    kinematics, names = plant.machine.kinematics(), target_named("sdf").names(plant)
    if kinematics is None:
        return
    joints = np.resize([0.3, -0.4], len(plant.machine.axes))
    state = Stepper(plant, RATE).reset(joints)
    moved = kinematics.drives.items()
    values = {names.joints[joint]: drive.ratio * float(state.joints[0, drive.column]) + drive.offset for joint, drive in moved}
    sdf = xml_root(folder / "out" / SDF_FILE)
    np.testing.assert_allclose(place_of(sdf, names.added[END_EFFECTOR], values)[:3, 3], state.ee[0], atol=1e-9)


def possible_moments(inertial: Any) -> bool:
    """Whether a body has these moments: all are positive, and none is above the sum of the others."""
    moments = np.zeros((3, 3))
    for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"):
        i, j = "xyz".index(key[1]), "xyz".index(key[2])
        moments[i, j] = moments[j, i] = float(inertial.findtext(f"inertia/{key}"))
    values = np.linalg.eigvalsh(moments)
    return bool(values[0] > 0.0 and values[2] <= (values[0] + values[1]) * (1.0 + 1e-9))


def xml_root(path: Path) -> Any:
    from defusedxml.ElementTree import parse

    return parse(path).getroot()


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
@pytest.mark.parametrize("make", MACHINES.values(), ids=MACHINES)
def test_every_machine_in_every_target(make: Any, target: Target, tmp_path: Path) -> None:
    plant = make()
    made = exported(plant, target, tmp_path)
    assert made.lacking == ()
    if target.name == "sdf":
        assert made.replay is None
        sdf_agrees(plant, tmp_path)
        return
    assert made.replay is not None
    assert made.replay.agrees
    moved = [row.signal for row in made.replay.rows if row.motion > 1e-2]
    assert {"base_turn.joint", "lift.joint"} <= set(moved), "the comparison is of motion"
    assert ("ee.x" in moved) == (plant.machine.urdf_text is not None)


def heavy(urdf: str) -> Plant:
    """An arm: forces at its joints move links with masses."""
    return plant_of(two_axes("force"), urdf)


ARMS = {
    "a root link called world": chain("world", mass=MASS),
    "no end stops": chain(kinds=("continuous", "continuous"), mass=MASS),
    "a slide": chain(kinds=("prismatic", "revolute"), mass=MASS),
    "a finger that follows": chain(mass=MASS)
    + link("finger", MASS)
    + joint("finger_joint", "revolute", ("fore", "finger"), "0.1 0 0", inside='<mimic joint="lift_joint" multiplier="-0.5"/>'),
    "a floating part": chain(mass=MASS) + link("part") + joint("float", "floating", ("fore", "part")),
    "a mass without moments": chain(mass='<inertial><origin xyz="0.1 0 0.02"/><mass value="2"/></inertial>'),
}


@pytest.mark.parametrize("urdf", ARMS.values(), ids=ARMS)
def test_arms_with_masses(urdf: str, tmp_path: Path) -> None:
    pytest.importorskip("pinocchio")
    plant = heavy(urdf)
    made = export_plant(plant, arm_dataset(plant), target_named("mjcf"), tmp_path / "out", samples=1)
    assert made.replay is not None
    assert made.replay.agrees
    assert {row.signal for row in made.replay.rows if row.motion > 1e-2} >= {"base_turn.command", "lift.command", "ee.x"}


@pytest.mark.parametrize("name", ["servo_arm", "velocity_crane", "torque_arm"])
def test_a_machine_from_an_mjcf(name: str, tmp_path: Path) -> None:
    """As ``init --from`` writes it, with what the MJCF says of lags, loads and friction."""
    assert run("init", tmp_path / "mine", "--name", "mine", "--from", robot(name)) == 0
    plant = nominal_plant(load_machine(tmp_path / "mine/datasets/mine/machine.toml"))
    massive = moves_masses(plant.machine)
    data = arm_dataset(plant) if massive else Dataset.of(plant.machine, [recording(plant, "r0")], {"r0": "held_out"})
    for target in TARGETS:
        if not target.arms and (massive or has_servos(plant)):
            with pytest.raises(SettingsError, match="--to mjcf writes"):
                export_plant(plant, data, target, tmp_path / target.name, samples=1)
            continue
        folder = tmp_path / target.name
        lacks = bool(lacking(plant, target))
        made = export_plant(plant, data, target, folder, force=lacks, samples=1)
        assert (made.replay is None) == (target.name == "sdf")
        assert made.replay is None or lacks or made.replay.agrees, target.name


#: What hangs on the chain of a description that is incomplete or has parts that no axis moves.
PARTS = {
    "a mass without moments": link("part", '<inertial><mass value="2"/></inertial>') + joint("hold", "fixed", ("fore", "part")),
    "no mass": link("part") + joint("hold", "fixed", ("fore", "part"), "0.1 0 0"),
    "moments without a mass": link("part", '<inertial><inertia ixx="1" iyy="1" izz="1"/></inertial>')
    + joint("hold", "fixed", ("fore", "part")),
    "a mass of zero": link("part", '<inertial><mass value="0"/><inertia ixx="0" iyy="0" izz="0"/></inertial>')
    + joint("hold", "fixed", ("fore", "part")),
    "moments of no body": link("part", '<inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="1"/></inertial>')
    + joint("hold", "fixed", ("fore", "part")),
    "a mesh that is not there": link("part", '<visual><geometry><mesh filename="package://x/y.stl"/></geometry></visual>')
    + joint("hold", "fixed", ("fore", "part")),
    "a free joint": link("part") + joint("free", "continuous", ("fore", "part")),
    "a floating part": link("part", MASS) + joint("float", "floating", ("fore", "part"), "0 0 0.2"),
    "a part that slides on a plane": link("part", MASS) + joint("plane", "planar", ("fore", "part"), "0 0 0.2"),
    "a mimic of nothing": link("part") + joint("slave", "revolute", ("fore", "part"), inside='<mimic joint="absent"/>'),
    "a mimic of what does not move": link("part") + joint("slave", "revolute", ("fore", "part"), inside='<mimic joint="end"/>'),
    "a mimic of itself": link("part") + joint("slave", "revolute", ("fore", "part"), inside='<mimic joint="slave"/>'),
    "a fixed joint with an axis of zero": link("part") + joint("hold", "fixed", ("fore", "part"), inside='<axis xyz="0 0 0"/>'),
}


@pytest.mark.parametrize("target", [t for t in TARGETS if t.name in ("mjcf", "urdf", "sdf", "newton")], ids=lambda t: t.name)
@pytest.mark.parametrize("part", PARTS.values(), ids=PARTS)
def test_incomplete_descriptions(part: str, target: Target, tmp_path: Path) -> None:
    """An export that agrees with the plant, or what the format cannot hold."""
    plant = plant_of(two_axes("position"), chain() + part)
    if "planar" in part and target.name == "sdf":
        with pytest.raises(SettingsError, match=r"sdf: joint 'plane': a planar joint; expected .* Change its type to fixed"):
            exported(plant, target, tmp_path)
        return
    made = exported(plant, target, tmp_path)
    if target.name == "sdf":
        sdf_agrees(plant, tmp_path)
        for inertial in xml_root(tmp_path / "out" / SDF_FILE).iter("inertial"):
            assert float(inertial.findtext("mass")) > 0.0
            assert possible_moments(inertial)
    else:
        assert made.replay is not None
        assert made.replay.agrees
    if target.name == "urdf" and "slave" in part:
        assert urdf_tree((tmp_path / "out/robot.urdf").read_text("utf-8")).find("joint/mimic") is None
    if target.name == "urdf":
        assert urdf_tree((tmp_path / "out/robot.urdf").read_text("utf-8")).find("link[@name='part']") is not None


@pytest.mark.parametrize("make", [servo, valves, sliding, without_urdf], ids=lambda make: make.__name__)
def test_the_validator_of_fmpy_finds_nothing(make: Any, tmp_path: Path) -> None:
    """Of axes of every kind, with a URDF and without; the hanging tool has signals of its own."""
    from fmpy.validation import validate_fmu

    plant = make()
    target_named("fmu").write(plant, RATE, tmp_path)
    assert validate_fmu(str(tmp_path / "Machine.fmu")) == []


@pytest.mark.parametrize("name", ["fmu", "lut", "json", "mjcf"])
def test_a_dataset_of_another_rate_is_replayed_at_its_rate(name: str, tmp_path: Path) -> None:
    plant = valves()
    slower = replace(plant, machine=replace(plant.machine, rate_hz=50.0))
    data = Dataset.of(slower.machine, [recording(slower, "r0")], {"r0": "held_out"})
    found = export_plant(plant, data, target_named(name), tmp_path / "out", samples=1)
    assert found.replay is not None
    assert found.replay.agrees
