"""The demo of an arm: what is hidden is in the machine and not in its model; the default is found."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import pytest

from sysid.errors import SettingsError

pytest.importorskip("pybullet_data", reason="the model of the arm is in the package pybullet")


@pytest.fixture(scope="module")
def demo(pipeline: Callable[[str], ModuleType]) -> ModuleType:
    return pipeline("demo_arm")


def compiled(demo: ModuleType, hide: list[str]) -> Any:
    spec = mujoco.MjSpec.from_string(demo.model_text(demo.shapes()))
    for each in map(demo.hidden_of, hide):
        each.kind.change(spec, each.joint, each.value)
    return spec.compile()


def test_the_model_has_the_masses_and_joints_of_the_urdf(demo: ModuleType) -> None:
    """Torques of gravity in three postures are those of the URDF as MuJoCo reads it."""
    urdf, model = demo.shapes(), compiled(demo, [])
    assert model.body_mass.sum() == pytest.approx(urdf.body_mass.sum(), rel=1e-8)
    for seed in range(3):
        posture = demo.HOME + np.random.default_rng(seed).uniform(-0.5, 0.5, 7)
        torques = []
        for each in (urdf, model):
            data = mujoco.MjData(each)
            data.qpos[:] = posture
            mujoco.mj_forward(each, data)
            torques.append(data.qfrc_bias.copy())
        np.testing.assert_allclose(torques[1], torques[0], rtol=1e-6, atol=1e-6)
        assert np.abs(torques[0]).max() > 10.0


@pytest.mark.parametrize(
    ("hide", "field", "index", "value"),
    [
        ("friction:joint2=6", "dof_frictionloss", 1, 6.0),
        ("armature:joint4=1.8", "dof_armature", 3, 0.9),
        ("mass:joint4=1.5", "body_mass", 4, 1.5 * 2.08),
        ("stiffness:joint1=0.8", "actuator_gainprm", (0, 0), 3600.0),
        ("damping:joint7=1.2", "actuator_biasprm", (6, 2), -240.0),
        ("delay:joint1=0.04", "actuator_delay", 0, 0.04),
    ],
)
def test_what_is_hidden_is_in_the_machine_alone(demo: ModuleType, hide: str, field: str, index: Any, value: float) -> None:
    assert np.asarray(getattr(compiled(demo, [hide]), field))[index] == pytest.approx(value)
    assert np.asarray(getattr(compiled(demo, []), field))[index] != pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("friction", "no KIND:JOINT=VALUE"),
        ("fricton:joint2=6", r"no kind 'fricton'; expected 'friction'\?"),
        ("friction:joint9=6", "no joint 'joint9'"),
        ("delay:joint1=2", r"the value 2; expected 0 to 0\.2 s"),
        ("mass:joint4=1e", "the value 1e; expected"),
    ],
)
def test_what_cannot_be_hidden_is_an_error(demo: ModuleType, text: str, expected: str) -> None:
    with pytest.raises(SettingsError, match=expected):
        demo.hidden_of(text)


@pytest.mark.slow
def test_three_of_three_are_named_with_their_values(demo: ModuleType, tmp_path: Path) -> None:
    result = json.loads(demo.main(tmp_path).read_text("utf-8"))
    assert (result["named"], result["wrong"]) == (3, [])
    found = {(e["name"], e["target"]): e["parameters"] for e in result["gap"]["effects"]}
    for text in demo.HIDDEN:
        each = demo.hidden_of(text)
        assert found[each.key][each.kind.parameter] == pytest.approx(each.value, rel=0.05)
    gap = result["gap"]["gap"]
    for signal, before in gap["before"].items():
        assert before > 2.0 * gap["noise_floor"][signal]
        assert gap["after"][signal] < 1.2 * gap["noise_floor"][signal]
    assert json.loads((tmp_path / "demo-arm" / "repaired" / "replay.json").read_text("utf-8"))["target"] == "mjcf"
    assert Path(result["files"]["picture"]).read_text("utf-8").count("<polygon") == 4 * 11
