"""Measured poses and servos of other people: geometry is learned from few poses, networks compared with simple models."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def parts(pipeline: Callable[[str], ModuleType]) -> tuple[ModuleType, ModuleType]:
    found = pipeline("calibration_sets")
    return found.poses, found.servos


@pytest.fixture(scope="module")
def measured() -> Path:
    folder = (ROOT / "../shared/data").resolve()
    if not (folder / "tiago_mocap").is_dir():
        pytest.skip("the measured data (../shared/data/tiago_mocap) are not here")
    return folder


def test_the_committed_figures_are_those_of_the_page(parts: tuple[ModuleType, ModuleType]) -> None:
    result = json.loads((ROOT / "reports/calibration_sets/result.json").read_text())
    page = (ROOT / "reports/networks/README.md").read_text()
    assert parts[0].tables(result["arms"]) in page
    assert parts[1].table(result["servos"]) in page


def test_frame_and_marker_are_found_from_a_few_poses(parts: tuple[ModuleType, ModuleType]) -> None:
    """Poses of the nominal arm in an unknown frame with an unknown marker: both come back, and mistakes hardly count."""
    from sysid.machine import load_machine

    poses = parts[0]
    machine = load_machine(ROOT / "datasets" / "ur10" / "machine.toml")
    rng = np.random.default_rng(0)
    q = rng.uniform(-1.5, 1.5, (20, 6))
    kinematics = machine.kinematics()
    last = kinematics.link_poses(q)["wrist_3_link"]
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    tip = (last[:, :3, 3] + last[:, :3, :3] @ [0.03, 0.2, -0.05]) @ turn.T + [0.5, -0.2, 0.9]
    wrong = tip.copy()
    wrong[3] += 0.2
    found = poses.registered(machine, q, wrong)
    ordinary = np.arange(20) != 3
    np.testing.assert_allclose(found.tip_position(q)[ordinary], tip[ordinary], atol=2e-3)


@pytest.mark.slow
def test_calibrated_geometry_predicts_poses_of_other_peoples_arms(parts: tuple[ModuleType, ModuleType], measured: Path) -> None:
    for arm, registered, calibrated in zip(parts[0].ARMS, (4.5, 16.0), (3.2, 6.0), strict=True):
        result: dict[str, Any] = parts[0].evaluated(arm, measured / "tiago_mocap", quick=True)["models"]
        assert result["geometry calibrated (structured)"]["distance_median"] < calibrated
        assert result["published geometry, frame and marker fitted"]["distance_median"] < registered
        learned = [found["distance_median"] for name, found in result.items() if "geometry" not in name]
        assert min(learned) > 10.0 * calibrated  # too few poses for anything that does not know the arm


@pytest.mark.slow
def test_servos_are_predicted_in_free_runs(parts: tuple[ModuleType, ModuleType], measured: Path) -> None:
    for item in parts[1].evaluated(measured, quick=True):
        assert min(item["rmse"].values()) < 0.6 * item["rmse"]["as told"] or item["servo"] == "SO-101"
        assert all(np.isfinite(value) for value in item["rmse"].values())


def test_a_free_run_stays_within_its_ends_and_sees_only_itself(parts: tuple[ModuleType, ModuleType]) -> None:
    servos = parts[1]
    command = np.r_[np.zeros(100), np.ones(200)]
    lag = np.zeros(300)
    for k in range(299):
        lag[k + 1] = lag[k] + 0.1 * (command[k] - lag[k])
    run = servos.Run("a", command, lag, np.zeros((300, 0)))
    x, y = servos.histories(run)

    def exact(h: Any) -> Any:
        return 0.1 * h[:, servos.COMMANDS - 1]

    np.testing.assert_allclose(exact(x), y, atol=1e-12)
    np.testing.assert_allclose(servos.free_run(exact, run, (-1.0, 2.0)), lag, atol=1e-12)
    assert servos.free_run(lambda h: np.ones(len(h)), run, (-1.0, 2.0)).max() == 2.0
    assert servos.rmse(servos.late(command, 0), run) > servos.rmse(servos.late(command, 10), run)
