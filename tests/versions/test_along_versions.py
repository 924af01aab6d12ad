"""Versions of networks that run along a motion: drift, difference, card, ONNX, policy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lift_motion import LINKAGE, dataset, lift, recording, with_roles
from version_data import piecewise

from sysid.datasets.recording import Dataset
from sysid.errors import SettingsError
from sysid.networks import ActuatorNetwork, HistoryNetwork, Mlp, Model, MotionNetwork, Normalisation, to_files
from sysid.networks.history_correction import HistoryCorrection
from sysid.networks.member import LearningCurve
from sysid.networks.motion_inputs import MotionBounds, Window
from sysid.registry import Registry
from sysid.reports.card import card_of
from sysid.validate import validate_model
from sysid.versions import diff_versions, drift_of, policy_checks
from sysid.versions.lineage import ModelLineage
from sysid.versions.onnx_export import export_onnx
from sysid.versions.policy import PromotionPolicy

NOTHING = ModelLineage("lift@1", "history", "0" * 64, 0, (), "lift@1", "0" * 64, "", None, (), (), ())


@pytest.fixture(scope="module")
def own() -> Dataset:
    return dataset()


def history(off: float = 0.0) -> dict[str, HistoryNetwork]:
    """The lift's linkage, and a memory that adds ``off`` [rad] at all times."""
    cylinder = np.linspace(0.0, 0.2, 40)
    joint = LINKAGE.joint(cylinder)
    ends = (float(joint.min()), float(joint.max()))
    order = np.argsort(joint)
    static = ActuatorNetwork("boom", piecewise(cylinder, joint), piecewise(joint[order], cylinder[order]), (0.0, 0.2), ends)
    shapes = {"mean": (3,), "scale": (3,), "W": (4, 3), "U": (4, 1), "b": (4,), "w": (1,), "w0": (1,)}
    weights = {name: np.zeros(shape) for name, shape in shapes.items()}
    quiet = HistoryCorrection(0.1, 0.1, np.array([0.002]), weights, 1.0, 10)
    said = replace(quiet, weights=weights | {"w0": np.array([np.arctanh(off / 0.1)])})
    return {"boom": HistoryNetwork(static, said, quiet)}


def motion(gain: float = 0.05) -> dict[str, MotionNetwork]:
    """Speed = gain · what is left of the command behind the lift's dead-band."""
    unit = Normalisation(np.zeros(1), np.ones(1))
    mlp = Mlp((np.array([[1.0, -1.0]]), np.array([[gain], [-gain]])), (np.full(2, -0.15), np.zeros(1)), unit, unit)
    course = LearningCurve((1, 1), 1, 1, (0.0,), (1,), (0.0,), (0.0,))
    window, bounds = Window(0.06, (0,), (0,), False), MotionBounds((-0.1, 0.1), (0.0, 0.2))
    network = MotionNetwork(
        "boom", "boom.command", "boom.cylinder", "m", window, (mlp, mlp), bounds, (-1.0, 1.0), (course,) * 2
    )
    return {"boom": network}


def later(gain: float = 1.0, off: float = 0.0) -> Dataset:
    """New recordings of the same lift; another one where ``gain`` or ``off`` say so."""
    runs = []
    for seed in (30, 31):
        run = recording(f"run-{seed}", seed)
        cylinder = 0.1 + gain * (run.values("boom.cylinder") - 0.1)
        table = run.table.assign(**{"boom.cylinder": cylinder, "boom.joint": LINKAGE.joint(cylinder) + off})
        runs.append(replace(run, table=table))
    return replace(with_roles(tuple(runs)), name="later", digest="1" * 64)


@pytest.mark.parametrize(
    ("model", "changed"), [(history(), later(off=0.01)), (motion(), later(gain=0.8))], ids=["history", "motion"]
)
def test_drift_is_found_and_none_where_there_is_none(own: Dataset, model: Model, changed: Dataset) -> None:
    assert drift_of(model, own, later(), "lift@1").verdict == "fits"
    found = drift_of(model, own, changed, "lift@1")
    assert found.verdict == "drifted"
    assert all(entry.rows == "motion" for entry in found.outputs)


def test_versions_differ_by_what_they_say_along_a_motion(tmp_path: Path) -> None:
    registry = Registry(tmp_path)

    def version(name: str, model: Model) -> object:
        kind, files = to_files(model)
        return registry.load(registry.register(name, kind, files, {"dataset": "lift@1"}, {}).reference)  # type: ignore[arg-type]

    one, two = version("lift-history", history()), version("lift-history", history(0.01))
    joint, cylinder = diff_versions(one, two).predictions  # type: ignore[arg-type]
    assert (joint.output, cylinder.output) == ("boom.joint", "boom.cylinder")
    assert joint.largest == pytest.approx(0.01)
    assert cylinder.largest == 0.0
    slow, fast = version("lift-motion", motion()), version("lift-motion", motion(0.06))
    (moved,) = diff_versions(slow, fast).predictions  # type: ignore[arg-type]
    assert 1e-3 < moved.largest < 0.2
    assert list(moved.at) == ["boom.command"]
    assert diff_versions(slow, slow).empty  # type: ignore[arg-type]
    for item, model, words in (
        (one, history(), "a recurrent part of 1 units"),
        (slow, motion(), "the mean of 2 perceptrons (2)"),
    ):
        text = card_of(item, NOTHING, model).markdown()  # type: ignore[arg-type]
        assert words in text


def test_motion_goes_to_onnx_and_history_says_why_not(tmp_path: Path) -> None:
    (file,) = export_onnx(motion(), tmp_path / "motion")
    assert file.file == "boom.motion.onnx"
    assert file.inputs == ("boom.command 0 s before",)
    with pytest.raises(SettingsError, match=r"actuator networks with history"):
        export_onnx(history(), tmp_path / "history")
    assert not (tmp_path / "history").exists()


def test_a_policy_judges_them_by_their_own_rules(own: Dataset) -> None:
    policy = PromotionPolicy()
    for model, worse in ((motion(), motion(0.06)), (history(), history(0.01))):
        good, bad = (validate_model(item, own, name=name) for item, name in ((model, "m@1"), (worse, "m@2")))
        assert all(check.status == "passed" for check in policy_checks(policy, good, good))
        assert any(check.status == "failed" for check in policy_checks(policy, bad, good))
    assert lift().axis_names == ("boom",)
