"""The USD stage: opened again by usd-core, checked against the registered schemas, and its numbers against the plant."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from palletiser import JOINTS, urdf
from test_drive_model import probe_plant
from test_every_target import gripper
from test_targets import recording

from sysid.export.newton import FILE, NewtonTarget
from sysid.export.replay import Replay, replay
from sysid.export.target import Start
from sysid.export.urdf import link_inertias
from sysid.export.usd_stage import SCENE, actuator_path, joint_path, link_path
from sysid.machine import KnownEffect, machine_from_files
from sysid.machine.urdf_tree import urdf_tree
from sysid.plant import Plant, nominal_plant
from sysid.testing.probe import RATE_HZ

pytest.importorskip("pxr")
pytest.importorskip("newton_usd_schemas")
TARGET = NewtonTarget()
#: Effects of the force axis of the probe that the schemas have.
NATIVE = (
    KnownEffect("viscous_friction", "slide", {"coefficient": 20.0}),
    KnownEffect("coulomb_friction", "slide", {"force": 2.0}),
    KnownEffect("inertia_error", "slide", {"ratio": 1.3}),
    KnownEffect("load_bias", "slide", {"force": 1.5}),
)


def undeclared(stage: Any) -> list[str]:
    """Authored properties and applied schemas that no registered schema declares, of every prim."""
    from pxr import Usd

    registry, found = Usd.SchemaRegistry(), []
    for prim in stage.Traverse():
        known = set(prim.GetPrimDefinition().GetPropertyNames())
        found += [str(p.GetPath()) for p in prim.GetAuthoredProperties() if p.GetName() not in known and not _is_transform(p)]
        for name in prim.GetAppliedSchemas():
            if registry.FindAppliedAPIPrimDefinition(name.partition(":")[0]) is None:
                found.append(f"{prim.GetPath()}: {name}")
        if prim.GetTypeName() and registry.FindConcretePrimDefinition(prim.GetTypeName()) is None:
            found.append(f"{prim.GetPath()}: {prim.GetTypeName()}")
    return found


def _is_transform(prop: Any) -> bool:
    return str(prop.GetName()).startswith("xformOp:")


def opened(plant: Plant, folder: Path) -> Any:
    from pxr import Usd

    TARGET.write(plant, RATE_HZ, folder)
    return Usd.Stage.Open(str(folder / FILE))


def replayed(plant: Plant, folder: Path) -> Replay:
    simulation = TARGET.simulation(plant, folder)
    assert simulation is not None
    return replay(plant, simulation, [recording()], {})


@pytest.mark.filterwarnings("ignore:LoadUsdPhysicsFromRange is deprecated")  # the new function rejects its own arguments
@pytest.mark.parametrize("effects", [(), NATIVE], ids=["nominal", "native"])
def test_the_stage_is_valid(effects: tuple[KnownEffect, ...], tmp_path: Path) -> None:
    """Every authored property is that of a registered schema, and the parser of UsdPhysics finds valid objects."""
    from pxr import UsdPhysics

    stage = opened(probe_plant(*effects), tmp_path)
    assert undeclared(stage) == []
    parsed = UsdPhysics.LoadUsdPhysicsFromRange(stage, ["/"])
    counts = {kind: len(paths) for kind, (paths, _) in parsed.items()}
    assert counts[UsdPhysics.ObjectType.Articulation] == 1
    assert counts[UsdPhysics.ObjectType.RevoluteJoint] == 3
    assert counts[UsdPhysics.ObjectType.PrismaticJoint] == 1
    assert all(about.isValid for _, found in parsed.values() for about in found)


def test_an_attribute_that_no_schema_declares_is_found(tmp_path: Path) -> None:
    from pxr import Sdf

    stage = opened(probe_plant(), tmp_path)
    prim = stage.GetPrimAtPath(joint_path("slide_joint"))
    assert prim.IsValid()
    prim.CreateAttribute("newton:dampling", Sdf.ValueTypeNames.Float).Set(1.0)
    assert undeclared(stage) == [f"{prim.GetPath()}.newton:dampling"]


def palletiser() -> Plant:
    """Links with masses, and a passive joint that follows the shoulder."""
    head = 'schema = 1\nname = "palletiser"\nrate_hz = 100.0\nurdf = "p.urdf"\ntip = "wrist_link"\n'
    axis = '[[axes]]\nname = "{0}"\njoint = "{0}"\nactuation = "velocity"\ndrives = "joint"\ngain = 0.5\n'
    files = {"machine.toml": head + "".join(axis.format(name) for name in JOINTS), "p.urdf": urdf()}
    return nominal_plant(machine_from_files(files, "palletiser"))


def test_masses_are_those_of_the_urdf(tmp_path: Path) -> None:
    stage, inertias = opened(palletiser(), tmp_path), link_inertias(urdf_tree(urdf()))
    assert len(inertias) == 5
    for link, (mass, centre, inertia) in inertias.items():
        prim = stage.GetPrimAtPath(link_path(link))
        assert prim.GetAttribute("physics:mass").Get() == pytest.approx(float(mass[0]))
        np.testing.assert_allclose(prim.GetAttribute("physics:centerOfMass").Get(), centre, atol=1e-6)
        moments = sorted(prim.GetAttribute("physics:diagonalInertia").Get())
        np.testing.assert_allclose(moments, np.linalg.eigvalsh(inertia), rtol=1e-5, atol=1e-8)


def test_a_passive_joint_follows_its_axis(tmp_path: Path) -> None:
    """Offset in degrees; the end effector is that of the kinematics in every pose, turned by two unequal axes."""
    plant = palletiser()
    stage, kinematics = opened(plant, tmp_path), plant.machine.kinematics()
    prim = stage.GetPrimAtPath(joint_path("leveller"))
    assert prim.GetRelationship("newton:mimicJoint").GetTargets() == [joint_path("shoulder")]
    assert prim.GetAttribute("newton:mimicCoef0").Get() == pytest.approx(math.degrees(0.2))
    assert prim.GetAttribute("newton:mimicCoef1").Get() == -1.0
    simulation = TARGET.simulation(plant, tmp_path)
    assert kinematics is not None
    assert simulation is not None
    for q in np.random.default_rng(0).uniform(-1.2, 1.2, (20, 4)):
        found = simulation.reset(Start(q, q, np.zeros(4), np.zeros(4)))
        expected = kinematics.tip_position(q[None])[0]
        np.testing.assert_allclose([found[f"ee.{axis}"] for axis in "xyz"], expected, atol=1e-6)


def test_native_axes_replay_with_the_numbers_of_the_stage(tmp_path: Path) -> None:
    """What the stage says is what moves: another number in it is found by the replay."""
    plant = probe_plant(*NATIVE)
    stage = opened(plant, tmp_path)
    assert replayed(plant, tmp_path).agrees
    places = {name: joint_path("slide_joint") for name in ("armature", "damping", "friction")}
    for name, path in (places | {"constEffort": actuator_path("slide")}).items():
        attribute = stage.GetPrimAtPath(path).GetAttribute(f"newton:{name}")
        kept = attribute.Get()
        attribute.Set(2.0 * kept)
        stage.Save()
        assert not replayed(plant, tmp_path).agrees, name
        attribute.Set(kept)
    stage.Save()
    assert replayed(plant, tmp_path).agrees


def test_a_slide_that_follows_a_hinge_has_a_drive(tmp_path: Path) -> None:
    """A mimic of the schemas is between joints of one kind: its units are those of both."""
    stage = opened(gripper(), tmp_path)
    left, thumb = (stage.GetPrimAtPath(joint_path(name)).GetAppliedSchemas() for name in ("left_joint", "thumb_joint"))
    assert "PhysicsDriveAPI:linear" in left
    assert "NewtonMimicAPI" not in left
    assert "NewtonMimicAPI" in thumb
    assert not any(name.startswith("PhysicsDriveAPI") for name in thumb)


def test_a_delayed_servo(tmp_path: Path) -> None:
    """In steps of the simulator, 1 ms here."""
    stage = opened(probe_plant(KnownEffect("input_delay", "wrist", {"delay": 0.034})), tmp_path)
    actuator = stage.GetPrimAtPath(actuator_path("wrist"))
    assert stage.GetPrimAtPath(SCENE).GetAttribute("newton:timeStepsPerSecond").Get() == 1000
    assert actuator.GetAttribute("newton:delaySteps").Get() == 34
    assert actuator.GetAppliedSchemas()[-1] == "NewtonActuatorDelayAPI"


def test_axes_with_other_effects_follow_the_drive_model(tmp_path: Path) -> None:
    plant = probe_plant(*NATIVE, KnownEffect("backlash", "slide", {"width": 0.01}, "drive"))
    stage = opened(plant, tmp_path)
    assert not stage.GetPrimAtPath(actuator_path("slide")).IsValid()
    joint = stage.GetPrimAtPath(joint_path("slide_joint"))
    assert "PhysicsDriveAPI:linear" in joint.GetAppliedSchemas()
    assert not joint.GetAttribute("newton:damping").HasAuthoredValue(), "damping is that of the drive model"


def test_angles_are_in_degrees_and_gravity_turns_with_the_base(tmp_path: Path) -> None:
    text = """schema = 1
name = "one"
rate_hz = 100.0
[[axes]]
name = "turn"
actuation = "force"
drives = "joint"
inertia = 2.0
joint_type = "revolute"
limits = [-0.5, 0.5]
"""
    plant = nominal_plant(machine_from_files({"machine.toml": text}, "one")).with_effect(
        KnownEffect("viscous_friction", "turn", {"coefficient": 3.0})
    )
    stage = opened(plant, tmp_path)
    joint = stage.GetPrimAtPath(joint_path("turn"))
    assert joint.GetAttribute("physics:upperLimit").Get() == pytest.approx(math.degrees(0.5))
    assert joint.GetAttribute("newton:damping").Get() == pytest.approx(3.0 * math.pi / 180.0), "N·m·s per degree"
    assert joint.GetAttribute("newton:armature").Get() == 2.0
    tilted = {"translation": [0.1, 0.0, 0.0], "rotation": [0.2, 0.0, 0.0]}
    (tmp_path / "tilted").mkdir()
    stage = opened(probe_plant(KnownEffect("base_misalignment", "base", tilted)), tmp_path / "tilted")
    down = stage.GetPrimAtPath(SCENE).GetAttribute("physics:gravityDirection").Get()
    np.testing.assert_allclose(down, [0.0, math.sin(0.2), -math.cos(0.2)], atol=1e-6)
