"""SDFormat: elements of the format, the same frames as the URDF, and what the check refuses."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, fromstring

import numpy as np
import numpy.typing as npt
import pytest
from test_drive_model import probe_plant

from sysid.errors import SettingsError
from sysid.export.sdf import FILE, SdfTarget, check_sdf, sdf_of
from sysid.export.urdf import END_EFFECTOR
from sysid.machine import KnownEffect
from sysid.machine.urdf_tree import urdf_tree
from sysid.plant import Plant
from sysid.plant.stepper import Stepper

Array = npt.NDArray[np.float64]
EFFECTS = (
    KnownEffect("joint_offset", "boom", {"offset": 0.1}),
    KnownEffect("link_length_error", "boom", {"error": 0.05}),
    KnownEffect("tip_offset", "ee", {"translation": [0.02, -0.01, 0.03]}),
    KnownEffect("base_misalignment", "base", {"translation": [0.1, 0.0, -0.1], "rotation": [0.02, 0.0, 0.1]}),
    KnownEffect("viscous_friction", "slide", {"positive": 1.0, "negative": 3.0}),
)


def written(plant: Plant, folder: Path) -> Element:
    SdfTarget().write(plant, 100.0, folder)
    return fromstring((folder / FILE).read_text("utf-8"))


def pose_of(text: str) -> Array:
    """A pose element as a matrix, by the specification: Rz(yaw)·Ry(pitch)·Rx(roll)."""
    x, y, z, roll, pitch, yaw = (float(word) for word in text.split())
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (roll, pitch, yaw))
    turn = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    return np.block([[turn, np.array([[x], [y], [z]])], [np.zeros((1, 3)), np.ones((1, 1))]])


def place_of(sdf: Element, link: str, values: dict[str, float]) -> Array:
    """Pose of a link in the measured frame at joint values, from the frames of the file alone."""
    by_child = {joint.findtext("child"): joint for joint in sdf.iter("joint")}
    chain = []
    while (parent := str(by_child[link].findtext("parent"))) != "world":
        chain.append(by_child[link])
        link = parent
    pose = np.eye(4)
    for joint in reversed(chain):
        pose = pose @ pose_of(str(joint.findtext("pose")))
        value = values.get(str(joint.get("name")), 0.0)
        axis = np.array([float(word) for word in str(joint.findtext("axis/xyz") or "0 0 0").split()])
        if joint.get("type") == "prismatic":
            pose = pose @ np.block([[np.eye(3), value * axis[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
        elif joint.get("type") == "revolute":
            x, y, z = axis
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            turn = np.eye(3) + np.sin(value) * cross + (1.0 - np.cos(value)) * (cross @ cross)
            pose = pose @ np.block([[turn, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
    return pose


def test_the_end_effector_is_that_of_the_plant(tmp_path: Path) -> None:
    """Every composed effect at once, at the values of the sensors."""
    plant = probe_plant(*EFFECTS)
    sdf, stepper = written(plant, tmp_path), Stepper(plant, 100.0)
    joints = np.array([0.3, 0.2, 0.1, -0.4])
    state = stepper.reset(joints)
    values = {str(axis.joint): float(state.joints[0, k]) for k, axis in enumerate(plant.machine.axes)}
    np.testing.assert_allclose(place_of(sdf, END_EFFECTOR, values)[:3, 3], state.ee[0], atol=1e-9)


def test_friction_is_the_mean_of_both_directions(tmp_path: Path) -> None:
    sdf = written(probe_plant(*EFFECTS), tmp_path)
    slide = next(joint for joint in sdf.iter("joint") if joint.get("name") == "slide_joint")
    assert float(str(slide.findtext("axis/dynamics/damping"))) == 2.0


def test_a_passive_joint_mimics() -> None:
    urdf = urdf_tree(
        """<robot name="r"><link name="a"/><link name="b"/><link name="c"/>
        <joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
          <limit lower="-1" upper="1"/></joint>
        <joint name="k" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/>
          <mimic joint="j" multiplier="-1" offset="0.5"/></joint></robot>"""
    )
    root = sdf_of(urdf, "r")
    check_sdf(root)
    mimic = root.find("model/joint[@name='k']/axis/mimic")
    assert mimic is not None
    assert mimic.get("joint") == "j"
    assert mimic.findtext("multiplier") == "-1"


def test_the_check_refuses_what_is_not_sdformat() -> None:
    root = Element("sdf")
    link = SubElement(SubElement(root, "model"), "link")
    SubElement(link, "mass")
    with pytest.raises(SettingsError, match="<mass> in <link>; expected one of pose, inertial"):
        check_sdf(root)


def test_the_check_refuses_a_number_that_is_not_finite() -> None:
    root = Element("sdf")
    inertial = SubElement(SubElement(SubElement(root, "model"), "link"), "inertial")
    SubElement(inertial, "mass").text = "nan"
    with pytest.raises(SettingsError, match="<mass> nan; expected 1 finite numbers"):
        check_sdf(root)
