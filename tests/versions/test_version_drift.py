"""A version that fits is left in peace, a machine that changed is found, and what is known is not counted as new."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from crane_data import dataset, motion, replaced
from version_data import actuator, structured

from sysid.datasets.recording import Dataset
from sysid.errors import ExcitationError
from sysid.versions import drift_of


@pytest.fixture(scope="module")
def own() -> Dataset:
    return dataset()


def later(*seeds: int, name: str = "later") -> Dataset:
    recordings = tuple(motion(f"new-{seed}", 30.0, seed) for seed in seeds)
    return replace(dataset(recordings), name=name, digest="1" * 64)


def verdicts(found: object) -> dict[str, str]:
    return {entry.output: entry.verdict for entry in found.outputs}  # type: ignore[attr-defined]


@pytest.mark.parametrize("seed", range(10, 16))
def test_the_same_machine_fits(own: Dataset, seed: int) -> None:
    found = drift_of(actuator("boom"), own, later(seed), "crane-actuator@1")
    assert found.verdict == "fits", verdicts(found)
    for entry in found.outputs:
        assert entry.ratio95[0] < entry.ratio < entry.ratio95[1]
        assert entry.outside == 0


@pytest.mark.slow
def test_chance_is_what_it_says(own: Dataset) -> None:
    """Of many comparisons of the same machine a p-value below 10 % is as rare as that, or rarer."""
    small = [
        entry.p_value < 0.1
        for seed in range(20, 50)
        for entry in drift_of(actuator("stick"), own, later(seed), seed=seed).outputs
    ]
    assert len(small) == 60
    assert sum(small) <= 15


def test_a_sensor_that_moved_is_found_where_it_is(own: Dataset) -> None:
    new = later(11)
    moved = replace(
        new, recordings=tuple(replaced(r, "boom.cylinder", r.values("boom.cylinder") + 1e-4) for r in new.recordings)
    )
    found = drift_of({**actuator("boom"), **actuator("stick")}, own, moved)
    assert found.verdict == "drifted"
    assert verdicts(found) == {
        "boom.joint": "drifted",
        "boom.cylinder": "drifted",
        "stick.joint": "fits",
        "stick.cylinder": "fits",
    }
    worst = found.outputs[1]
    assert worst.rmse == pytest.approx(1e-4, rel=0.2)
    assert worst.p_value < 1e-3


def test_errors_outside_the_ranges_are_no_drift(own: Dataset) -> None:
    """A network that was fitted on half of the stroke is wrong beyond it: that is its range and not the machine."""
    half = actuator("boom", low=-0.43, high=0.5)
    found = drift_of(half, own, later(12))
    assert found.verdict == "beyond its ranges"
    assert set(verdicts(found).values()) == {"fits"}
    joint = next(item for item in found.inputs if item.signal == "boom.joint")
    assert joint.fitted == (-0.43, 0.5)
    assert joint.found[1] > 1.0
    assert 0.2 < joint.outside < 0.8
    assert json.loads(json.dumps(found.to_json()))["verdict"] == "beyond its ranges"


def test_poses_and_motion_of_a_forward_model(own: Dataset) -> None:
    found = drift_of(structured(), own, later(13))
    assert {(entry.output, entry.rows) for entry in found.outputs} == {(f"ee.{letter}", "motion") for letter in "xyz"}


def test_what_it_knows_is_left_out(own: Dataset) -> None:
    grown = replace(later(14), recordings=(*own.recordings, *later(14).recordings))
    found = drift_of(actuator("boom"), own, grown)
    assert found.recordings == ("new-14",)
    assert found.known == ("run-1", "run-2", "run-3", "poses")
    with pytest.raises(ExcitationError, match=r"drift of crane@1 on crane@1: none of its 4 recordings is new to it.*run-1"):
        drift_of(actuator("boom"), own, own, "crane@1")


def test_a_handful_of_rows_is_not_judged(own: Dataset) -> None:
    new = later(15)
    short = replace(new.recordings[0], table=new.recordings[0].table.iloc[:12])
    found = drift_of(actuator("boom"), own, replace(new, recordings=(short,)))
    assert found.verdict == "not comparable"
    assert found.to_json()["outputs"][0]["p_value"] is None
    assert np.isnan(found.outputs[0].p_value)
