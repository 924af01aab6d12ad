"""The measurement of a pose set: its frame, its measured point, and poses that scatter by more than its noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sysid.gap import GapResult, find_gap
from sysid.gap.arm.pose_rows import PoseRows
from sysid.gap.arm.pose_stage import fit_pose_stage
from sysid.gap.data import Data, SearchInput
from sysid.gap.prepare.case import open_case, stage_candidates
from sysid.plant import compile_plant, nominal_plant
from tests.helpers.pose_sets import Arm, Hidden, dataset_of, pose_set

SMALL = Arm("zyyx", Arm().links[:4], Arm().masses[:4])
NOISE = 3e-4
#: A capture system that stands elsewhere: a metre and a half away, turned by 125°.
ELSEWHERE = Hidden(translation=(-0.9, 0.4, 1.1), rotation=tuple(Rotation.from_euler("zyx", [120, 20, -15], True).as_rotvec()))


def found(hidden: Hidden, count: int = 80, noise: float = NOISE, marker: bool = False) -> GapResult:
    dataset = dataset_of(SMALL, NOISE, pose_set(SMALL, hidden, count, noise, 3), marker=marker)
    return find_gap(dataset, nominal_plant(dataset.machine))


def names(result: GapResult) -> set[tuple[str, str]]:
    return {(e.name, e.target) for e in result.effects}


def test_a_frame_that_is_turned_and_far_away_is_found_beside_the_errors_of_the_arm() -> None:
    result = found(replace(ELSEWHERE, offset={1: 0.01}, compliance={2: 3e-4}))
    assert names(result) == {("base_misalignment", "base"), ("joint_offset", "j2"), ("joint_compliance", "j3")}
    frame = next(e for e in result.effects if e.target == "base")
    np.testing.assert_allclose(frame.parameters["translation"], ELSEWHERE.translation, atol=2e-3)
    turn = Rotation.from_rotvec(frame.parameters["rotation"]) * Rotation.from_rotvec(ELSEWHERE.rotation).inv()
    assert turn.magnitude() < 3e-3
    assert max(result.gap.after.values()) < 1.3 * NOISE


def test_a_point_whose_place_is_not_known_is_estimated_with_the_frame() -> None:
    hidden = replace(ELSEWHERE, tip=(0.08, -0.05, 0.12), offset={1: 0.01})
    result = found(hidden, marker=True)
    assert names(result) == {("base_misalignment", "base"), ("tip_offset", "ee"), ("joint_offset", "j2")}
    point = next(e for e in result.effects if e.name == "tip_offset")
    np.testing.assert_allclose(point.parameters["translation"], hidden.tip, atol=2e-3)
    assert point.units == {"translation": "m"}


def test_the_point_is_where_the_urdf_states_it_unless_the_description_leaves_it_open() -> None:
    for marker in (False, True):
        dataset = dataset_of(SMALL, NOISE, pose_set(SMALL, Hidden(), 40, NOISE, 1), marker=marker)
        case, stages = open_case(dataset, nominal_plant(dataset.machine), 0)
        candidates = {c.effect.name for c in stage_candidates(case, stages[0])}
        assert ("tip_offset" in candidates) is marker


@pytest.mark.parametrize("marker", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_poses_that_scatter_by_far_more_than_their_noise_name_nothing_but_the_measurement(marker: bool) -> None:
    """Poses that belong to other rows, a marker that slipped: an error of the arm that explains a tenth of it is a guess."""
    result = found(replace(ELSEWHERE, offset={1: 0.002}), noise=20.0 * NOISE, marker=marker)
    assert names(result) <= {("base_misalignment", "base"), ("tip_offset", "ee")}


def test_eleven_joints_and_four_hundred_poses_need_few_evaluations_of_the_model(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counts instead of seconds: linearisations, each of all unknowns, and no model that is fitted by itself."""
    axes = "zyyxyxzyxyx"
    links = tuple(Arm().links[k % 6] for k in range(11))
    arm = Arm(axes, links, tuple(Arm().masses[k % 6] for k in range(11)))
    hidden = Hidden(offset={1: 0.01, 4: -0.008}, length={2: 0.004}, compliance={1: 5e-5, 2: 7e-5}, rotation=(0.004, 0.0, 0.01))
    dataset = dataset_of(arm, NOISE, pose_set(arm, hidden, 400, NOISE, 3))
    case, stages = open_case(dataset, nominal_plant(dataset.machine), 0)
    stage = next(s for s in stages if s.problem.stage == "end_effector")
    candidates = stage_candidates(case, stage)
    lanes, predicted = [], PoseRows.predicted

    def counted(rows: PoseRows, thetas: np.ndarray) -> np.ndarray:
        lanes.append(len(thetas))
        return predicted(rows, thetas)

    monkeypatch.setattr(PoseRows, "predicted", counted)
    model = compile_plant(case.plant)
    labels = [c.label for c in candidates]
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    fit_pose_stage(SearchInput(model, seen, stage.theta, candidates, labels, lambda text: None))
    unknowns = sum(len(c.unknowns) for c in candidates)
    linearisations = sum(lanes) / (2 * unknowns + 1)
    assert linearisations < 25, f"{sum(lanes)} lanes for {unknowns} unknowns"
