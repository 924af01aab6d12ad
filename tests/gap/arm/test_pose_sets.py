"""Datasets of static poses alone: names, ties, folds, and what is said about them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sysid.errors import ExcitationError
from sysid.gap import GapResult, find_gap
from sysid.gap.arm.pose_folds import dealt
from sysid.gap.prepare.case import held_out_of, open_case
from sysid.gap.stages import search_stages
from sysid.plant import nominal_plant
from sysid.progress import silent
from tests.helpers.pose_sets import Arm, Hidden, dataset_of, pose_set, tips

ARM = Arm()
SMALL = Arm("zyyx", ARM.links[:4], ARM.masses[:4])
NOISE = 3e-4
#: An elastic arm: geometry and compliance off together.
ELASTIC = Hidden(
    offset={1: -0.011, 3: 0.008},
    length={1: 0.004},
    compliance={1: 5e-5, 2: 7e-5},
    translation=(0.01, -0.006, 0.004),
    rotation=(0.004, -0.009, 0.012),
)
NAMES = {
    ("joint_offset", "j2"), ("joint_offset", "j4"), ("link_length_error", "j2"), ("joint_compliance", "j2"),
    ("joint_compliance", "j3"), ("base_misalignment", "base"),
}  # fmt: skip


def found_in(dataset) -> GapResult:
    return find_gap(dataset, nominal_plant(dataset.machine))


def names(result: GapResult) -> set[tuple[str, str]]:
    return {(e.name, e.target) for e in result.effects}


def distance(errors) -> float:
    return float(np.sqrt(sum(errors[f"ee.{c}"] ** 2 for c in "xyz")))


@pytest.fixture(scope="module")
def elastic() -> GapResult:
    sets = [pose_set(ARM, ELASTIC, n, NOISE, seed, f"set-{seed}") for seed, n in ((1, 300), (2, 100), (3, 100))]
    roles = {"set-1": "fit", "set-2": "select", "set-3": "held_out"}
    return found_in(dataset_of(ARM, NOISE, *sets, roles=roles))


def test_geometry_and_compliance_hidden_together_are_both_named(elastic: GapResult) -> None:
    assert names(elastic) == NAMES
    assert elastic.ambiguous == ()


def test_compliances_are_right_within_their_intervals(elastic: GapResult) -> None:
    for effect in elastic.effects:
        if effect.name == "joint_compliance":
            truth = ELASTIC.compliance[int(effect.target[1]) - 1]
            low, high = effect.interval95["compliance"]
            assert low - 0.3 * (high - low) < truth < high + 0.3 * (high - low)
            assert effect.parameters["compliance"] == pytest.approx(truth, rel=0.15)


def test_held_out_error_is_that_of_the_truth(elastic: GapResult) -> None:
    """The truth leaves the noise alone."""
    assert distance(elastic.gap.after) < 1.3 * NOISE * np.sqrt(3.0)
    assert elastic.held_out_recordings == ("set-3",)


def test_nothing_about_motion_is_expected_of_poses(elastic: GapResult) -> None:
    text = " ".join((*elastic.next_experiment, *elastic.notes))
    for word in ("backlash", "clock", "sway", "command"):
        assert word not in text
    assert {e.name for e in elastic.excitation} <= {
        "joint_offset", "link_length_error", "joint_compliance", "base_misalignment", "sensor_scale", "sensor_bias",
    }  # fmt: skip


def test_noise_alone_has_no_gap() -> None:
    poses = pose_set(SMALL, Hidden(), 60, NOISE, 4)
    assert found_in(dataset_of(SMALL, NOISE, poses)).verdict == "no_gap"


def test_geometry_alone_is_not_called_compliance() -> None:
    hidden = Hidden(offset={1: 0.01}, length={2: -0.003})
    result = found_in(dataset_of(SMALL, NOISE, pose_set(SMALL, hidden, 120, NOISE, 5)))
    assert names(result) == {("joint_offset", "j2"), ("link_length_error", "j3")}


@pytest.mark.slow
def test_a_tilted_axis_that_no_effect_describes_gets_no_wrong_name() -> None:
    """Small errors of every axis, as of any arm that was assembled."""
    draw = np.random.default_rng(6)
    hidden = Hidden(tilt={k: tuple(draw.normal(0.0, 1e-3, 3)) for k in range(4)}, compliance={1: 4e-4})
    result = found_in(dataset_of(SMALL, NOISE, pose_set(SMALL, hidden, 200, NOISE, 7)))
    # A tilt about the next joint's own axis is a zero offset of that joint, or a turned base before the first one.
    allowed = {("joint_compliance", "j2"), ("base_misalignment", "base"), *(("joint_offset", f"j{k}") for k in range(1, 5))}
    assert names(result) <= allowed
    assert ("joint_compliance", "j2") in names(result)


def test_a_tilted_base_is_not_a_joint_offset_while_the_joint_before_it_rests() -> None:
    joints = np.random.default_rng(8).uniform(-1.5, 1.5, (80, 4))
    joints[:, 0] = 0.3 + 1e-3 * joints[:, 0]
    hidden = Hidden(offset={1: 0.01})
    result = found_in(dataset_of(SMALL, NOISE, pose_set(SMALL, hidden, 80, NOISE, 9, joints=joints)))
    assert result.ambiguous == ((("joint_offset", "j2"), ("base_misalignment", "base")),)
    assert names(result) == set()
    assert "cannot be distinguished" in " ".join(result.next_experiment)


def test_three_sets_of_few_poses_without_roles_run_and_every_pose_is_tested() -> None:
    sets = [pose_set(SMALL, Hidden(offset={1: 0.01}), 14, NOISE, seed, f"set-{seed}") for seed in (1, 2, 3)]
    dataset = dataset_of(SMALL, NOISE, *sets)
    result = found_in(dataset)
    assert names(result) == {("joint_offset", "j2")}
    tested = held_out_of(open_case(dataset, nominal_plant(dataset.machine), 0)[0])
    assert sum(len(r) for r in tested) == 42
    assert result.gap.before["ee.z"] > 5.0 * result.gap.after["ee.z"]


def test_a_fold_is_predicted_without_its_own_poses() -> None:
    """Tips that are wrong in one fold alone do not change the values that predict it."""
    hidden = Hidden(offset={1: 0.01})
    clean = pose_set(SMALL, hidden, 60, NOISE, 10)
    wrong = clean.table.copy()
    rows = wrong["time"].isin(dealt(clean)[1].table["time"])
    wrong.loc[rows, "ee.z"] += 0.05
    found = []
    for recording in (clean, replace(clean, table=wrong)):
        dataset = dataset_of(SMALL, NOISE, recording)
        case, stages = open_case(dataset, nominal_plant(dataset.machine), 0)
        stage = search_stages(case, stages, "all", silent)[0]
        theta = stage.found.fit.theta
        fold = next(r for r in stage.split.held_out if r.name.endswith("#2"))
        found.append(stage.problem.predict(theta[None], fold))
    assert np.allclose(found[0], found[1], atol=1e-6)  # the optimiser of the sizes ends within rounding


def test_too_few_poses_are_refused_with_what_to_record() -> None:
    with pytest.raises(ExcitationError, match=r"15 of them.*20 static poses") as refused:
        found_in(dataset_of(SMALL, NOISE, pose_set(SMALL, Hidden(), 15, NOISE, 1)))
    assert "work space" in str(refused.value)


def test_the_generator_agrees_with_the_plant() -> None:
    from sysid.machine import KnownEffect
    from sysid.plant import compile_plant

    plant = nominal_plant(ARM.machine(NOISE))
    for k, value in ELASTIC.offset.items():
        plant = plant.with_effect(KnownEffect("joint_offset", f"j{k + 1}", {"offset": value}))
    for k, value in ELASTIC.length.items():
        plant = plant.with_effect(KnownEffect("link_length_error", f"j{k + 1}", {"error": value}))
    for k, value in ELASTIC.compliance.items():
        plant = plant.with_effect(KnownEffect("joint_compliance", f"j{k + 1}", {"compliance": value}, "structure"))
    where = {"translation": list(ELASTIC.translation), "rotation": list(ELASTIC.rotation)}
    plant = plant.with_effect(KnownEffect("base_misalignment", "base", where))
    model, poses = compile_plant(plant), pose_set(ARM, ELASTIC, 20, 0.0, 11)
    joints = np.column_stack([poses.values(f"{name}.joint") for name in ARM.names])
    assert np.allclose(model.tip(model.theta[None], poses)[0], tips(ARM, ELASTIC, joints), atol=1e-9)
