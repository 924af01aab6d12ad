"""The comparison with mujoco.sysid: machines, commands, and that each method gets the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest


@pytest.fixture
def study(pipeline: Callable[[str], ModuleType]) -> ModuleType:
    return pipeline("mujoco_sysid")


def test_the_machine_has_the_error_and_the_model_under_test_has_not(study: ModuleType) -> None:
    case = study.CASES[0]
    real, tested = (study.specification(case, case.right, truth).compile() for truth in (case.truth, {}))
    assert real.actuator_delay[0] == pytest.approx(0.03)
    controls = study.controls_of(case, real, 0)
    late, now = study.run(real, controls, case.rate_hz), study.run(tested, controls, case.rate_hz)
    jump = int(np.argmax(np.abs(np.diff(controls[:, 0])) > 0.05)) + 1
    assert abs(late[jump + 1, 0] - late[jump, 0]) < 1e-9
    assert abs(now[jump + 1, 0] - now[jump, 0]) > 1e-3


def test_recordings_differ_and_begin_at_rest(study: ModuleType) -> None:
    case = study.CASES[2]
    model = mujoco.MjModel.from_xml_string(case.xml)
    first, second = (study.controls_of(case, model, k) for k in range(2))
    assert np.abs(first - second).max() > 0.1
    assert np.abs(study.run(model, first, case.rate_hz)[:5]).max() < 1e-3
    assert list(study.ROLES.values()).count("held_out") == 1


@pytest.mark.slow
def test_the_dead_time_is_found_by_both_and_only_one_says_so(study: ModuleType, tmp_path: Path) -> None:
    from mujoco import sysid as peer

    if not hasattr(peer, "ParameterDict"):
        pytest.skip("mujoco.sysid lacks packages: pip install 'mujoco-core[sysid]'")
    rows = {row["method"]: row for row in study.solve(replace(study.CASES[0], seconds=6.0), tmp_path)}
    assert rows["sysid gap"]["found"].startswith("input_delay (hinge) 0.03")
    for method in ("sysid gap", "mujoco.sysid, right parameters"):
        assert rows[method]["rmse"] < 0.01 * rows["model under test"]["rmse"]
    assert rows["mujoco.sysid, other parameters"]["rmse"] > 0.1 * rows["model under test"]["rmse"]


def gap_row(study: ModuleType, case: object, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """The row of `sysid gap`, without runs of the other method."""
    monkeypatch.setattr(study, "peer", lambda case, *rest: (dict.fromkeys(case.right, 0.0), 0.0))
    monkeypatch.setattr(study, "CASES", ())
    bare = replace(case, other={})  # type: ignore[type-var]
    return next(row for row in study.solve(bare, folder) if row["method"] == "sysid gap")


@pytest.mark.slow
def test_worn_joints_of_an_arm_and_nothing_else(
    study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """A constant load of the elbow is as large as the torque by which the first moment of its link is uncertain."""
    row = gap_row(study, study.CASES[2], tmp_path, monkeypatch)
    names = [part.split(" ")[0] for part in str(row["found"]).split(", ")]
    assert names == ["viscous_friction", "coulomb_friction"]
    assert float(str(row["rmse"])) < 1e-3


@pytest.mark.slow
def test_rotors_described_fifty_times_too_small(study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mujoco.sysid.tests import test_integration as example

    case = study.own_example()
    row = gap_row(study, case, tmp_path, monkeypatch)
    found = dict(part.removeprefix("inertia_error (").split(") ") for part in str(row["found"]).split(", "))
    assert set(found) == set(example.TRUE_ARMATURE)
    for name, value in example.TRUE_ARMATURE.items():
        assert 0.01 * float(found[name]) == pytest.approx(value, rel=0.1)
