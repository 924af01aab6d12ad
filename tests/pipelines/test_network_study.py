"""The study of the networks: its poses are the crane's, its drawing is off, and what it committed is what it is said to be."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from sysid.machine import load_machine
from sysid.networks import PAPER_MAX

ROOT = Path(__file__).parents[2]
RESULT = ROOT / "reports" / "networks" / "result.json"


@pytest.fixture(scope="module")
def study(pipeline: Callable[[str], ModuleType]) -> dict[str, ModuleType]:
    import importlib

    pipeline("networks")
    return {name: importlib.import_module(f"learned.{name}") for name in ("poses", "forward", "actuators", "page", "pictures")}


@pytest.fixture(scope="module")
def result() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(RESULT.read_text("utf-8"))
    return found


def test_poses_are_those_of_the_crane_with_noise(study: dict[str, ModuleType]) -> None:
    kinematics = load_machine(ROOT / "datasets" / "autolog" / "machine.toml").kinematics()
    assert kinematics is not None
    own = study["poses"]
    low, high = own.limits("full")
    inner_low, inner_high = own.limits("part")
    assert (inner_low > low).all()
    assert (inner_high < high).all()
    found = own.poses("full", 400, 1, 2)
    np.testing.assert_allclose(found.tip, kinematics.tip_position(found.joints), atol=1e-9)
    assert (found.joints >= low).all()
    assert (found.joints <= high).all()
    np.testing.assert_allclose((found.captured - found.joints).std(axis=0), own.JOINT_NOISE, rtol=0.15)
    np.testing.assert_allclose((found.seen_tip - found.tip).std(axis=0), own.TIP_NOISE, rtol=0.15)
    slew = np.abs(found.own[:, 0] - found.joints[:, 0])
    assert np.radians(0.4) < slew.max() < np.radians(0.95)
    other = own.poses("full", 400, 1, 3)
    assert np.abs(found.joints - other.joints).max() > 0.1


def test_a_drawing_is_off_by_millimetres_and_fifty_poses_mend_it(
    study: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The row that the documentation rests on, made again for one seed."""
    forward = study["forward"]
    monkeypatch.setattr(forward, "SEEDS", (0,))
    drawn = forward.figures("full", [forward.as_drawn(0)])
    assert 2e-3 < max(drawn["max"]) < 0.1
    models = forward.structures("full", 50)
    assert set(models) == {"structured"}
    assert max(forward.figures("full", models["structured"])["max"]) < 2e-3
    assert set(forward.structures("full", 75)) == {"structured", "chain"}


def test_the_true_linkage_runs_over_the_stroke(study: dict[str, ModuleType]) -> None:
    machine = load_machine(ROOT / "datasets" / "autolog" / "machine.toml")
    for axis in study["actuators"].AXES:
        cylinder, joint = study["actuators"].true_linkage(axis).T
        np.testing.assert_allclose(sorted(cylinder[[0, -1]]), machine.axis(axis).stroke, atol=2e-3)
        assert (np.diff(joint) > 0.0).all()


def of(rows: list[dict[str, Any]], **where: Any) -> dict[str, Any]:
    (row,) = (row for row in rows if all(row[key] == value for key, value in where.items()))
    return row


def test_what_was_reached(study: dict[str, ModuleType], result: dict[str, Any]) -> None:
    best = study["forward"].BEST.label
    reached = of(result["variants"], range="part", asked="joints", model=best)
    assert all(error <= limit for error, limit in zip(reached["max"], PAPER_MAX.values(), strict=True))
    for reach in ("full", "part"):
        assert max(of(result["variants"], range=reach, asked="joints", model="structured")["max"]) <= 1e-3
        fifty = of(result["forward"], range=reach, poses=50, model="structured")
        for variant in (study["forward"].PAPER.label, best):
            assert max(fifty["max"]) < min(of(result["forward"], range=reach, poses=500, model=variant)["max"])
    for row in result["actuators"]:
        if row["rows"] == 1500 and row["model"] == "network, relu":
            assert row["motion_rmse"] < 1.1 * row["sensors"]


def test_the_page_and_the_pictures_are_those_of_the_result(study: dict[str, ModuleType], result: dict[str, Any]) -> None:
    assert study["page"].tables(result) in (ROOT / "reports" / "networks" / "README.md").read_text("utf-8")
    for name, text in study["pictures"].pictures(result).items():
        assert (RESULT.parent / name).read_text("utf-8") == text
        drawn = ElementTree.fromstring(text)
        assert len(list(drawn.iter("{http://www.w3.org/2000/svg}polyline"))) > 20
