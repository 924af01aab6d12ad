"""Robots that others wrote: those of pybullet_data, and the MuJoCo Menagerie where SYSID_MENAGERIE names its folder."""

from __future__ import annotations

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest

from sysid.errors import SettingsError
from sysid.machine import machine_from_files
from sysid.machine.sources.draft import MachineDraft, machine_text
from sysid.machine.sources.mjcf import mjcf_draft
from sysid.machine.sources.urdf import urdf_draft

#: Driven joints of arms of pybullet_data.
ARMS = {"kuka_iiwa/model.urdf": 7, "xarm/xarm6_robot.urdf": 6, "xarm/xarm6_with_gripper.urdf": 6}
MJCF = {"thrower.xml": 7, "reacher.xml": 2}


def pybullet_robots() -> Path:
    pybullet_data = pytest.importorskip("pybullet_data", reason="pybullet_data is not installed")
    return Path(pybullet_data.getDataPath())


def checked(draft: MachineDraft, model: mujoco.MjModel | None = None) -> None:
    """The draft is a machine; with a model, its kinematics are those of the model."""
    machine = machine_from_files({"machine.toml": machine_text(draft, "robot"), "robot.urdf": draft.urdf}, draft.source)
    kinematics = machine.kinematics()
    assert kinematics is not None
    if model is None:
        return
    data = mujoco.MjData(model)
    places = [model.joint(axis.joint).qposadr[0] for axis in machine.axes]
    sites = [model.site(k).name for k in range(model.nsite)]
    for q in np.random.default_rng(0).uniform(-0.5, 0.5, (5, len(places))):
        data.qpos[places] = q
        for joint, drive in kinematics.drives.items():
            if joint not in [axis.joint for axis in machine.axes]:
                data.qpos[model.joint(joint).qposadr[0]] = drive.ratio * q[drive.column] + drive.offset
        mujoco.mj_kinematics(model, data)
        tip = machine.tip or ""
        found = data.site(tip).xpos if tip in sites else data.body(tip.removesuffix("_tip")).xpos
        np.testing.assert_allclose(kinematics.tip_position(q)[0], found, atol=1e-6)


@pytest.mark.parametrize("name", ARMS)
def test_urdfs_of_pybullet(name: str) -> None:
    text = (pybullet_robots() / name).read_text("utf-8")
    draft = urdf_draft(text, name, kind="servo")
    assert len(draft.axes) == ARMS[name]
    checked(draft)


@pytest.mark.parametrize("name", MJCF)
def test_mjcfs_of_pybullet(name: str) -> None:
    path = pybullet_robots() / "mjcf" / name
    draft = mjcf_draft(path)
    assert len(draft.axes) == MJCF[name]
    checked(draft, mujoco.MjModel.from_xml_path(str(path)))


def test_robots_of_the_menagerie() -> None:
    """Each is a machine, or refused with the element that cannot be expressed and what to do about it."""
    folder = os.environ.get("SYSID_MENAGERIE")
    if not folder:
        pytest.skip("SYSID_MENAGERIE names no folder of models")
    models = sorted(path for path in Path(folder).glob("*/*.xml") if not path.name.startswith("scene"))
    assert models
    drafted, unexplained = 0, list[str]()
    for path in models:
        try:
            draft = mjcf_draft(path)
        except SettingsError as error:
            unexplained += [path.name] if not error.expected else []
            continue
        checked(draft, mujoco.MjModel.from_xml_path(str(path)))
        drafted += 1
    assert unexplained == []
    assert drafted > 0
