"""MJCF models in the style of the MuJoCo Menagerie: each is a machine, or refused with what to do about it.

They have classes of defaults, general actuators, meshes in files, keyframes, tendons, free joints, equality constraints and
included files; they are written for these tests.
"""

from __future__ import annotations

import shutil
import struct
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import pytest
from command_line import run
from robots import robot
from test_public_robots import checked

from sysid.datasets.recording import Recording
from sysid.errors import InputError, SettingsError
from sysid.gap.adapters.mujoco.native import write_native
from sysid.gap.adapters.mujoco.repair import relocate, write_spec
from sysid.gap.adapters.mujoco.simulator import MujocoSimulator
from sysid.machine import KnownEffect, load_machine
from sysid.machine.sources.mjcf import mjcf_draft
from sysid.machine.sources.mjcf_model import load_mjcf, load_spec

#: Model → options, driven axes, tip, and what the notes name.
MACHINES = {
    "gripper_arm": (
        (),
        ["joint1", "joint2", "joint3"],
        "hand",
        ["actuators beside the chain: actuator8"],
    ),
    "scene": ((), ["joint1", "joint2", "joint3"], "hand", ["actuators beside the chain: actuator8"]),
    "hand": ((), ["FFJ4", "FFJ3"], "proximal", ["actuators beside the chain: A_FFJ0"]),
    "mobile": (
        (),
        ["base_x", "base_y", "base_th", "lift", "wrist"],
        "wrist",
        ["ball joint of free_swing", "spring of wrist", "gravity compensation"],
    ),
    "bimanual": (("left_gripper",), ["left_shoulder", "left_elbow"], "left_gripper", ["actuators beside the chain"]),
}  # fmt: skip
REFUSED = {
    "biped": (None, r"biped\.xml: the joint of body 'base' is free, and 2 chains of 2 .*Add --base base --tip left_calf\."),
    "biped-leg": ("left_calf", r"the joint of body 'base' is free; .*Add --base base --tip left_calf\."),
    "drone": (None, r"drone\.xml: no joint that moves by itself; expected a robot with hinges or slides"),
    "bimanual": (None, r"2 chains of 2 driven joints, to left_gripper and right_gripper; .*Add --tip left_gripper\."),
    "closed": (None, r"equality of rod and out: a closed loop across crank; .*<equality><joint>"),
    "hand-tendon": (
        "distal",
        r"tip 'distal': no actuator drives joint 'FFJ1', which moves the chain; .*Add --tip proximal, which is in front",
    ),
    "mobile-ball": ("free_swing", r"tip 'free_swing': joint 'ball' is a ball joint; .*Add --tip wrist, which"),
}


@pytest.fixture
def models(tmp_path: Path) -> Path:
    """The models with their mesh."""
    folder = tmp_path / "menagerie"
    shutil.copytree(robot("joint").parent / "menagerie", folder)
    corners = [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    triangles = [
        struct.pack("<3f", 0, 0, 0) + b"".join(struct.pack("<3f", *corners[k]) for k in face) + b"\0\0" for face in faces
    ]
    (folder / "assets").mkdir()
    (folder / "assets/link.stl").write_bytes(b"\0" * 80 + struct.pack("<I", len(faces)) + b"".join(triangles))
    return folder


@pytest.mark.parametrize("name", MACHINES)
def test_a_model_becomes_a_machine(name: str, models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tip, axes, end, notes = MACHINES[name]
    path = models / f"{name}.xml"
    options = ("--tip", *tip) if tip else ()
    assert run("init", tmp_path / "mine", "--name", "mine", "--from", path, *options) == 0
    shown = " ".join("".join(capsys.readouterr()).split())
    for note in notes:
        assert note in shown
    machine = load_machine(tmp_path / "mine/datasets/mine/machine.toml")
    assert list(machine.axis_names) == axes
    assert machine.tip == end
    checked(mjcf_draft(path, *tip), mujoco.MjModel.from_xml_path(str(path)))


@pytest.mark.parametrize("case", REFUSED)
def test_a_model_is_refused_with_what_to_do(case: str, models: Path) -> None:
    tip, message = REFUSED[case]
    with pytest.raises(SettingsError, match=message):
        mjcf_draft(models / f"{case.partition('-')[0]}.xml", tip)


def test_a_scene_runs_and_is_repaired_in_another_folder(models: Path, tmp_path: Path) -> None:
    """A model of several files beside a loose object: the repaired one finds its meshes and moves as the model does."""
    path, out = models / "scene.xml", tmp_path / "repaired/scene.xml"
    assert run("init", tmp_path / "mine", "--name", "mine", "--from", path) == 0
    machine = replace(load_machine(tmp_path / "mine/datasets/mine/machine.toml"), rate_hz=50.0)
    time = np.arange(100) / 50.0
    columns = {"time": time}
    for k, axis in enumerate(machine.axis_names):
        columns[f"{axis}.command"] = columns[f"{axis}.joint"] = 0.3 * np.sin((k + 1.0) * time)
    recording = Recording("run", pd.DataFrame(columns), 50.0)
    before = MujocoSimulator(path, machine).simulate(recording)
    assert before["joint1.joint"].std() > 0.05
    assert before["ee.z"].between(0.2, 0.8).all(), "the hand holds its place above the ground"
    spec, model = load_spec(path), load_mjcf(path)
    delay = KnownEffect("input_delay", "joint2", {"delay": 0.06})
    native, beside = write_native(spec, model, machine, [delay], path.name)
    assert (len(native), beside) == (1, [])
    relocate(spec, path, out)
    write_spec(spec, out)
    with pytest.raises(InputError, match=rf"link.stl' is outside .* --assets {models.resolve()}/assets"):
        MujocoSimulator(out, machine)
    after = MujocoSimulator(out, machine, (models,)).simulate(recording)
    np.testing.assert_allclose(after["joint1.joint"], before["joint1.joint"], atol=2e-3)
    late = after["joint2.joint"].to_numpy()[53:]
    np.testing.assert_allclose(late, before["joint2.joint"].to_numpy()[50:-3], atol=5e-3)
