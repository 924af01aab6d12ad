"""Maps put an error where it is, coverage counts by region, the linkage baseline finds its triangle, clocks explain spikes."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations

import numpy as np
import numpy.typing as npt
import pytest
from crane_data import LINKAGES, dataset, motion, poses, replaced

from sysid.datasets.recording import ClockRecord
from sysid.files import plain
from sysid.networks import ForwardRecipe, NetworkRecipe, fit_forward
from sysid.networks.split import RowRange, gather
from sysid.validate import validate_forward
from sysid.validate.baselines import baseline_models, linkage_geometry
from sysid.validate.error_analysis import MapAxis, direction_of, edges_of, error_map, error_maps, places_in, spikes
from sysid.validate.metrics import coverage_of

Array = npt.NDArray[np.float64]


def axes(n: int = 4000, seed: int = 0) -> tuple[MapAxis, MapAxis, MapAxis]:
    rng = np.random.default_rng(seed)
    x, y, z = rng.uniform(-1.0, 1.0, (3, n))
    return MapAxis("a.joint", "rad", x), MapAxis("b.joint", "rad", y), MapAxis("speed of a.joint", "rad/s", z, "signed")


def test_a_map_shows_an_error_where_it_is() -> None:
    a, b, _ = axes()
    errors = np.where((a.values > 0.5) & (b.values < -0.5), 2.0, 0.0)
    found = error_map(errors, a, b)
    assert found is not None
    row, column = found.worst
    assert found.edges[0][row] > 0.3
    assert found.edges[1][column + 1] < -0.3
    assert found.rmse[row][column] == pytest.approx(2.0)
    assert sum(map(sum, found.count)) == 4000
    assert found.explains > 0.6


def test_the_most_telling_pair_comes_first_and_what_does_not_vary_has_none() -> None:
    a, b, speed = axes()
    still = MapAxis("c.joint", "rad", np.full(4000, 0.3))
    found = error_maps(np.sign(speed.values) * np.abs(a.values), combinations([a, b, speed, still], 2))
    assert found[0].over == ("a.joint", "speed of a.joint")
    assert all("c.joint" not in item.over for item in found)
    assert found[0].explains > 5.0 * found[-1].explains


def test_few_rows_make_few_bins_and_very_few_no_map() -> None:
    a, b, _ = axes(60)
    found = error_map(np.ones(60), a, b)
    assert found is not None
    assert len(found.count) == 3
    assert error_map(np.ones(20), *axes(20)[:2]) is None
    assert json.dumps(plain(found.rmse), allow_nan=False)


def test_bins_of_values_with_a_sign_hold_zero_in_one() -> None:
    edges = edges_of(np.linspace(-0.3, 1.0, 1000), "signed")
    assert edges is not None
    assert edges[0] == -edges[-1]
    middle = len(edges) // 2
    assert edges[middle - 1] < 0.0 < edges[middle]
    assert edges_of(np.full(10, 0.2)) is None
    np.testing.assert_array_equal(places_in(np.array([0.0, 1.0, 2.0]), np.array([-5.0, 0.5, 1.5, 9.0])), [0, 0, 1, 1])
    np.testing.assert_array_equal(direction_of(np.array([-1.0, 0.001, np.nan, 2.0])), [-1.0, 0.0, np.nan, 1.0])


def test_coverage_is_counted_by_region() -> None:
    x = np.linspace(0.0, 3.0, 300, endpoint=False)
    truth = np.where(x < 1.0, 2.0, 0.0)
    found = coverage_of(truth, (np.full(300, -1.0), np.full(300, 1.0)), x > 0.5, x[:, None], ["a.joint"], 0.01)
    assert found.covered == pytest.approx(2.0 / 3.0)
    assert found.half_width == 1.0
    assert found.flagged == pytest.approx(51 / 300)
    shares = {region.name: region.covered for region in found.regions}
    assert shares["a.joint, lower third"] < 0.02
    assert shares["a.joint, upper third"] == 1.0
    assert shares["outside the data"] == 0.0
    assert sum(region.count for region in found.regions[2:]) == 300


def test_a_report_counts_the_intervals_of_a_model_that_has_them() -> None:
    data = dataset((poses(count=500),), {})
    model = fit_forward(data, NetworkRecipe(forward=ForwardRecipe(model="structured", residual=False)))
    entry = validate_forward(model, data).output("ee.x", "poses")
    assert entry.coverage is not None
    assert entry.coverage.covered > 0.85
    assert entry.coverage.flagged < 0.1
    assert 1e-4 < entry.coverage.half_width < 3e-3
    values = entry.coverage.regions
    assert {"inside the data", "slew.joint, lower third"} <= {region.name for region in values}
    blind = validate_forward(replace(model, uncertainty=None), data).output("ee.x", "poses")
    assert blind.coverage is None


@pytest.mark.parametrize("axis", ["boom", "stick"])
@pytest.mark.parametrize("to_joint", [True, False])
def test_the_linkage_baseline_finds_the_triangle(axis: str, to_joint: bool) -> None:
    rng = np.random.default_rng(0)
    joints = rng.uniform(-0.4, 1.2, 400) if axis == "boom" else rng.uniform(-2.4, -0.3, 400)
    displacements = LINKAGES[axis].displacement(joints)
    predict = linkage_geometry(displacements, joints + rng.normal(0.0, 1e-4, 400), to_joint)
    source, truth = (displacements, joints) if to_joint else (joints, displacements)
    assert np.sqrt(np.mean((predict(source[:, None]) - truth) ** 2)) < (1e-3 if to_joint else 1e-4)


def test_simple_models_learn_one_output_or_several() -> None:
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 2))
    several = baseline_models(x, np.column_stack([x[:, 0], x[:, 0] * x[:, 1]]))
    assert list(several) == ["polynomial, degree 3", "polynomial, degree 5", "gradient boosting", "nearest neighbour"]
    assert {predict(x[:7]).shape for predict in several.values()} == {(7, 2)}
    assert {predict(x[:7]).shape for predict in baseline_models(x, x[:, 0]).values()} == {(7,)}


def test_a_spike_where_a_clock_was_set_says_so() -> None:
    recording = motion("run", 20.0)
    time = recording.values("time")
    recording = replaced(recording, "boom.cylinder", 0.05 + 0.002 * time / 20.0)
    joint = LINKAGES["boom"].joint(recording.values("boom.cylinder"))
    rng = np.random.default_rng(0)
    recording = replaced(recording, "boom.joint", joint + rng.normal(0.0, 1e-4, len(time)) + 0.05 * (np.abs(time - 6.0) < 0.02))
    rows = gather([RowRange(recording, 0, len(recording))], ("boom.cylinder", "boom.joint"))
    errors = LINKAGES["boom"].joint(rows.values[:, 0]) - rows.values[:, 1]
    data = dataset((recording,), {"run": "held_out"})

    def cause(record: ClockRecord) -> str:
        at_clock = replace(data, clocks=(record,), streams={"mocap": ("boom.joint",)})
        (spike,) = spikes(at_clock, rows, errors, {}, {}, is_motion=True)
        return spike.cause

    record = ClockRecord("run", "mocap.csv", 6.1, 0.0, (6.1, 6.1), (0.0, 0.0), 1.0, (), applied=True, reason="piece 2 of 2: …")
    assert cause(record) == "clock of mocap.csv set"
    assert cause(replace(record, offset_s=9.0)) == "unexplained"
    assert cause(replace(record, offset_s=0.0, applied=False, reason="nothing moved")) == "clock of mocap.csv not aligned"
