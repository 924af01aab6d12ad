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
    pytest.importorskip("tabulate", reason="mujoco.sysid needs it")
    rows = {row["method"]: row for row in study.solve(replace(study.CASES[0], seconds=6.0), tmp_path)}
    assert rows["sysid gap"]["found"].startswith("input_delay (hinge) 0.030")
    for method in ("sysid gap", "mujoco.sysid, right parameters"):
        assert rows[method]["rmse"] < 0.01 * rows["model under test"]["rmse"]
    assert rows["mujoco.sysid, other parameters"]["rmse"] > 0.1 * rows["model under test"]["rmse"]
