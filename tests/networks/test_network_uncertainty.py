"""Intervals hold as often as they say, also where the spread says nothing; queries outside the data are flagged."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from crane_data import HIGH, LOW, dataset, measured, poses
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid.datasets.recording import Dataset
from sysid.errors import InputError, StoreError
from sysid.networks import (
    ActuatorNetwork,
    ForwardRecipe,
    Mlp,
    NetworkRecipe,
    NetworkUncertainty,
    Normalisation,
    StructuredForward,
    fit_forward,
    from_files,
    to_files,
)
from sysid.networks.uncertainty import FALSE_FLAGS, Intervals, TrainingDomain

Array = npt.NDArray[np.float64]


@given(st.integers(0, 1000), st.sampled_from([0.5, 0.8, 0.9]), st.sampled_from(["normal", "heavy", "spread"]))
@settings(max_examples=20)
def test_intervals_hold_at_least_as_often_as_asked(seed: int, level: float, kind: str) -> None:
    """Whatever the errors are like; 400 calibrations of 60 rows, each asked once."""
    rng = np.random.default_rng(seed)
    shape = (400, 61)
    errors = rng.standard_t(2, shape) if kind == "heavy" else rng.normal(size=shape)
    spread = rng.uniform(0.1, 3.0, shape) if kind == "spread" else np.zeros(shape)
    errors = errors * np.hypot(spread, 0.3)
    held = []
    for row, own in zip(errors, spread, strict=True):
        reach = Intervals.of(row[:60, None], own[:60, None]).reach(own[60:, None], level)
        held.append(abs(row[60]) <= reach[0, 0])
    assert level - 0.075 < np.mean(held) < level + 0.09


def test_the_spread_widens_intervals_where_it_tells_errors_and_not_where_it_does_not() -> None:
    rng = np.random.default_rng(0)
    spread = rng.uniform(0.1, 2.0, (500, 1))
    telling = Intervals.of(rng.normal(size=(500, 1)) * spread, spread)
    blind = Intervals.of(rng.normal(size=(500, 1)), spread)
    ends = np.array([[0.1], [2.0]])
    narrow, wide = telling.reach(ends, 0.9)[:, 0]
    assert wide > 8.0 * narrow
    narrow, wide = blind.reach(ends, 0.9)[:, 0]
    assert wide < 1.3 * narrow


def test_few_rows_cannot_promise_much() -> None:
    found = Intervals.of(np.arange(1.0, 13.0)[:, None], np.zeros((12, 1)))
    with pytest.raises(InputError, match=r"level 0.95 from 12 rows; expected at most 0.923. Record more, or request a lower"):
        found.reach(np.zeros((1, 1)), 0.95)
    assert found.reach(np.zeros((1, 1)), 0.92)[0, 0] == pytest.approx(12.0)
    with pytest.raises(InputError, match=r"level 95; expected a share between 0 and 1, as 0.95"):
        found.reach(np.zeros((1, 1)), 95)


@pytest.mark.parametrize("width", [1, 2, 4])
def test_rows_like_the_data_are_hardly_flagged_and_others_are(width: int) -> None:
    rng = np.random.default_rng(width)
    found = TrainingDomain.of(rng.uniform(-1.0, 1.0, (500, width)))
    assert np.mean(~found.inside(rng.uniform(-1.0, 1.0, (5000, width)))) < FALSE_FLAGS + 0.01
    far = rng.uniform(-1.0, 1.0, (200, width))
    far[:, 0] = 1.3
    assert not found.inside(far).any()


def test_a_hole_in_the_data_is_outside() -> None:
    rng = np.random.default_rng(0)
    rows = rng.uniform(-1.0, 1.0, (1500, 2))
    found = TrainingDomain.of(rows[np.hypot(*rows.T) > 0.5])
    assert not found.inside(0.2 * rng.uniform(-1.0, 1.0, (100, 2))).any()
    assert (found.distance(np.zeros((1, 2))) > 2.0).all()


def test_dense_rows_have_no_gaps_that_matter() -> None:
    """Evenly spaced rows: between two of them nothing is outside, however close they are."""
    found = TrainingDomain.of(np.linspace(0.0, 1.0, 1500)[:, None])
    assert found.inside(np.random.default_rng(0).uniform(0.0, 1.0, (1000, 1))).all()
    assert not found.inside(np.array([[1.05], [-0.05]])).any()


@pytest.fixture(scope="module")
def data() -> Dataset:
    return dataset((poses(count=400),), {})


@pytest.fixture(scope="module")
def structured(data: Dataset) -> StructuredForward:
    model = fit_forward(data, NetworkRecipe(forward=ForwardRecipe(model="structured", residual=False)))
    assert isinstance(model, StructuredForward)
    return model


def test_a_fitted_model_knows_its_intervals_and_its_data(structured: StructuredForward) -> None:
    rng = np.random.default_rng(5)
    table = measured(LOW + (HIGH - LOW) * rng.random((500, 4)), rng)
    q = table[[f"{axis}.joint" for axis in ("slew", "boom", "stick", "telescope")]].to_numpy()
    tip = table[["ee.x", "ee.y", "ee.z"]].to_numpy()
    low, high = structured.predict_interval(q, 0.9)
    assert 0.82 < np.mean((tip >= low) & (tip <= high)) < 0.97
    np.testing.assert_allclose(0.5 * (low + high), structured.predict(q))
    assert np.mean(structured.inside(q)) > 0.96
    assert not structured.inside(q + np.array([0.0, 0.0, 0.0, 0.3])).any()
    assert structured.inside(q[0]).shape == (1,)


def test_files_contain_it_and_earlier_files_are_refused(structured: StructuredForward) -> None:
    q = 0.5 * (LOW + HIGH)[None]
    kind, files = to_files(structured)
    again = from_files(files, "crane-forward@1")
    assert isinstance(again, StructuredForward)
    np.testing.assert_array_equal(again.predict_interval(q)[0], structured.predict_interval(q)[0])
    assert to_files(again) == (kind, files)
    old = from_files(to_files(replace(structured, uncertainty=None))[1], "crane-forward@1")
    assert isinstance(old, StructuredForward)
    with pytest.raises(InputError, match=r"a version without intervals and training domain; expected .* Fit it again"):
        old.predict_interval(q)
    with pytest.raises(InputError, match=r"Fit it again"):
        old.inside(q)


def test_arrays_of_another_network_are_refused(structured: StructuredForward) -> None:
    assert structured.uncertainty is not None
    narrow = replace(structured.uncertainty.domain, rows=structured.uncertainty.domain.rows[:, :3])
    files = to_files(replace(structured, uncertainty=replace(structured.uncertainty, domain=narrow)))[1]
    with pytest.raises(StoreError, match=r"trust: arrays that do not fit the network; expected 4 inputs and 3 outputs"):
        from_files(files, "crane-forward@1")


def test_it_works_without_torch(structured: StructuredForward, tmp_path: Path) -> None:
    for name, content in to_files(structured)[1].items():
        (tmp_path / name).write_bytes(content)
    code = f"""
import sys
from pathlib import Path
import numpy as np
from sysid.networks import from_files
model = from_files({{p.name: p.read_bytes() for p in Path({str(tmp_path)!r}).iterdir()}}, "x")
q = np.array([[0.0, 0.5, -1.0, 0.1]])
model.predict_interval(q), model.inside(q)
print("torch" in sys.modules or "sklearn" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_an_actuator_network_has_both_of_both_directions() -> None:
    rng = np.random.default_rng(0)
    inputs = rng.uniform(0.0, 0.1, (300, 1))
    uncertainty = NetworkUncertainty.of(inputs, rng.normal(0.0, 1e-3, (100, 1)), np.zeros((100, 1)))
    assert uncertainty is not None
    unit = Normalisation(np.zeros(1), np.ones(1))

    def line(slope: float) -> Mlp:
        return Mlp((np.array([[slope]]),), (np.zeros(1),), unit, unit)

    network = ActuatorNetwork("boom", line(10.0), line(0.1), (0.0, 0.1), (0.0, 1.0), uncertainty={"to_joint": uncertainty})
    low, high = network.predict_interval("to_joint", np.array([0.05, 0.06]))
    np.testing.assert_allclose(0.5 * (low + high), [0.5, 0.6])
    assert high[0] - low[0] == pytest.approx(2.0 * 1.96e-3, rel=0.3)
    np.testing.assert_array_equal(network.inside("to_joint", np.array([0.05, 0.2])), [True, False])
    with pytest.raises(InputError, match=r"actuator network of boom: a version without intervals"):
        network.inside("to_cylinder", np.array([0.5]))
