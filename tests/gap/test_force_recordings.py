"""A force axis is compared in the recordings in which it moves; those in which it rests do not stop the workflow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plant_data import dataset_of, nominal, slide

from sysid.datasets import Dataset, Recording
from sysid.errors import ExcitationError
from sysid.gap import find_gap, steps
from sysid.machine import KnownEffect


def at_rest(recording: Recording, name: str) -> Recording:
    table = recording.table.copy()
    noise = np.random.default_rng(5).normal(0.0, 1e-6, len(table))
    table["slide.joint"] = 0.1 + noise
    table["slide.command"] = 0.0
    return replace(recording, name=name, table=table)


def with_rests(dataset: Dataset, *roles: str) -> Dataset:
    more = [at_rest(dataset.recordings[0], f"rest-{role}") for role in roles]
    splits = {**dataset.splits, **{f"rest-{role}": role for role in roles}}
    return Dataset.of(dataset.machine, (*dataset.recordings, *more), splits)  # type: ignore[arg-type]


def test_a_recording_in_which_the_axis_rests_is_left_out() -> None:
    dataset = with_rests(dataset_of(nominal(machine=slide()), 8.0), "fit", "select", "held_out")
    study = steps.open_study(dataset, nominal(machine=slide()))
    (stage,) = study.stages
    assert not any(r.name.startswith("rest") for part in stage.split.roles for r in part)
    assert len(stage.split.seen) == 3


@pytest.mark.slow
def test_the_result_is_that_without_it() -> None:
    truth = nominal(KnownEffect("viscous_friction", "slide", {"coefficient": 150.0}), machine=slide())
    dataset = with_rests(dataset_of(truth, 8.0), "fit", "select", "held_out")
    plain = find_gap(dataset_of(truth, 8.0), nominal(machine=slide()))
    found = find_gap(dataset, nominal(machine=slide()))
    assert [e.name for e in found.effects] == [e.name for e in plain.effects] != []
    assert found.effects[0].parameters == pytest.approx(plain.effects[0].parameters, rel=1e-6)


def test_an_axis_that_rests_in_a_whole_role_has_no_stage() -> None:
    dataset = dataset_of(nominal(machine=slide()), 8.0)
    rests = tuple(at_rest(r, r.name) if dataset.splits[r.name] == "held_out" else r for r in dataset.recordings)
    with pytest.raises(ExcitationError, match="run-4: slide: the axis hardly moves"):
        steps.open_study(replace(dataset, recordings=rests), nominal(machine=slide()))
