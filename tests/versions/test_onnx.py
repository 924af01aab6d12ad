"""ONNX files predict what the version does, in its range and beyond, or there are none."""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from crane_data import HIGH, LOW
from palletiser import JOINTS, urdf
from version_data import actuator, forward, structured

from sysid.errors import SettingsError, StorageError, StoreError
from sysid.machine.kinematics import Kinematics
from sysid.networks import Calibration, FittedChain, Geometry, Model, StructuredForward
from sysid.versions import export_onnx
from sysid.versions.onnx_graph import Graph


def palletiser_forward() -> StructuredForward:
    """A chain with a passive joint, all of whose joints deflect, axially and laterally."""
    kinematics = Kinematics.from_urdf(urdf(), joints=JOINTS, tip="wrist_link", tool=None)
    geometry = Geometry(kinematics)
    values = geometry.priors * np.random.default_rng(3).normal(size=len(geometry.parameters))
    structure = Calibration(geometry, values, np.diag((0.01 * geometry.priors) ** 2), 1e-3, ())
    low, high = np.full(len(JOINTS), -1.2), np.full(len(JOINTS), 1.2)
    names, turning = tuple(f"{name}.joint" for name in JOINTS), (True,) * len(JOINTS)
    return StructuredForward(
        joints=names, revolute=turning, structure=structure, urdf=urdf(), members=(), bound=0.0, low=low, high=high
    )


onnx = pytest.importorskip("onnx", reason="the extra onnx is not installed")
onnxruntime = pytest.importorskip("onnxruntime", reason="the extra onnx is not installed")

MODELS: dict[str, Model] = {
    "network": forward(),
    "sincos": forward("sincos", members=3),
    "products": forward("products", members=2, rectifier="smooth"),
    "calibrated": structured(),
    "calibrated and corrected": structured(members=2),
    "chain": structured("chain"),
    "elastic": structured("elastic", members=1),
    "passive": palletiser_forward(),
    "actuators": {**actuator("boom"), **actuator("stick")},
}


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", MODELS)
def test_parity(name: str, precision: str, tmp_path: Path) -> None:
    model = MODELS[name]
    files = export_onnx(model, tmp_path / "out", {"reference": "crane@1"}, precision)  # type: ignore[arg-type]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"export.json", *(entry.file for entry in files)}
    for entry in files:
        content = (tmp_path / "out" / entry.file).read_bytes()
        session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
        facts = session.get_modelmeta().custom_metadata_map
        assert facts["reference"] == "crane@1"
        low, high = np.array(entry.low), np.array(entry.high)
        share = np.random.default_rng(7).uniform(-0.3, 1.3, (200, len(low)))
        q = (low + share * (high - low)).astype(precision)
        said = session.run(["outputs"], {"inputs": q})[0]
        assert said.dtype == precision
        if isinstance(model, dict):
            axis, direction = entry.file.split(".")[:2]
            own = getattr(model[axis], direction).predict(q)
        else:
            own = model.predict(q)  # type: ignore[union-attr]
        rounding = float(np.finfo(precision).eps)
        np.testing.assert_allclose(said, own, rtol=0.0, atol=32.0 * rounding * np.abs(own).max())


def test_a_file_that_predicts_otherwise_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    constant = Graph.constant
    monkeypatch.setattr(
        Graph,
        "constant",
        lambda self, values, whole=False: constant(self, values if whole else np.asarray(values) * (1 + 1e-4), whole),
    )
    with pytest.raises(StoreError, match=r"ONNX of forward: ee\.x differs by .*; expected at most .* \(rounding of float32\)"):
        export_onnx(forward(), tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_what_float32_cannot_carry_is_said(tmp_path: Path) -> None:
    """Terms of a kilometre that cancel to a metre."""
    model, middle = structured("chain"), 0.5 * (LOW + HIGH)
    chain = model.structure
    assert isinstance(chain, FittedChain)
    large = replace(chain, weights=1e3 * chain.weights)
    settled = replace(large, level=large.level - large.predict(middle[None])[0])
    near = replace(model, structure=settled, low=middle, high=middle + 1e-3)
    assert export_onnx(near, tmp_path / "double", precision="float64")
    with pytest.raises(StoreError, match="Export it with --precision float64"):
        export_onnx(near, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_folder_with_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(SettingsError, match="exists and is not an export; expected a new folder"):
        export_onnx(actuator(), tmp_path)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    for _ in range(2):  # the export of before is replaced
        export_onnx(actuator(), tmp_path / "out")


def test_a_full_disk_leaves_the_export_of_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    export_onnx(actuator(), tmp_path / "out")
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        with pytest.raises(StorageError, match=r"No space left on device\); nothing was exported"):
            export_onnx(actuator("stick"), tmp_path / "out")
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "onnxruntime", None)
    with pytest.raises(
        SettingsError,
        match=r"onnxruntime is not installed; expected the extra\. pip install 'sysid-toolkit\[onnx\]' installs it",
    ):
        export_onnx(actuator(), tmp_path / "out")
