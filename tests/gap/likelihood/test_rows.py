"""Recordings as rows of a regression: means, blocks, restarts, and averages for stages without dynamics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from plant_data import dataset_of, nominal
from regression_stage import NOISE, SIGNAL, functions, problem, recordings, rows_of

from sysid.datasets.recording import Recording
from sysid.gap.likelihood import rows as rows_module
from sysid.gap.likelihood.rows import BIN, BLOCK, STATIC_SPAN, StageRows, averaged, averaged_out, bin_means
from sysid.gap.problem import drive_problem
from sysid.gap.stage_kind import FORCE, JOINT, SPEED, TIP, TOOL, StageKind
from sysid.plant import compile_plant


def test_a_bin_is_the_mean_of_what_was_measured_if_half_was() -> None:
    values = np.arange(12.0).reshape(1, 12, 1)
    values[0, [0, 4, 5, 6], 0] = np.nan
    assert bin_means(values, 4)[0, :, 0].tolist() == pytest.approx([2.0, np.nan, 9.5], nan_ok=True)
    assert bin_means(values, 5).shape == (1, 2, 1)


def test_residuals_are_means_of_measured_less_predicted() -> None:
    plant = compile_plant(nominal())
    dataset = dataset_of(nominal(), 8.0)
    stage = drive_problem(plant, plant.machine.axis("slew"))
    theta = nominal().vector()
    rows = StageRows(stage, dataset.recordings, theta, np.array([2e-4]))
    width = round(BIN * 100.0)
    left = stage.measured(dataset.recordings[0]) - stage.predict(theta[None], dataset.recordings[0])[0]
    first = rows.series[0]
    assert first.width == width
    expected = left[: len(first.step) * width, 0].reshape(-1, width).mean(axis=1)
    assert rows.residuals(theta[None])[0, first.rows] == pytest.approx(expected)
    assert first.step == pytest.approx(np.full(len(first.step), BIN))
    assert rows.measured_rows == rows.count


def test_every_row_is_in_one_block_of_a_few_seconds() -> None:
    rows = rows_of((0.0, 0.0, 0.0), count=3, seconds=22.0)
    assert rows.blocks == 3 * round(22.0 / BLOCK)
    for b in range(rows.blocks):
        (at,) = np.nonzero(rows.block == b)
        assert (np.diff(at) == 1).all()
        (s,) = (s for s in rows.series if s.rows.start <= at[0] < s.rows.stop)
        assert at[-1] < s.rows.stop, "no block reaches over two recordings"
        assert 0.7 * BLOCK < len(at) * BIN < 1.4 * BLOCK


def test_what_is_not_measured_leaves_nothing() -> None:
    given = recordings((0.5, 0.0, 0.0), count=1)
    table = given[0].table.copy()
    table.loc[50:149, SIGNAL] = np.nan
    rows = StageRows(problem(), [replace(given[0], table=table)], np.zeros(3), np.array([NOISE]))
    gap = slice(50, 150)
    assert not rows.series[0].present[gap].any()
    assert rows.measured_rows == rows.count - 100
    assert (rows.residuals(np.array([[0.3, 0.0, 0.0]]))[0, gap] == 0.0).all()


def test_a_prediction_that_loses_its_ends_is_taken_from_the_nominal_one() -> None:
    given = problem()

    def predict(thetas, recording):  # type: ignore[no-untyped-def]
        out = (functions(recording.values("clock")) @ thetas.T).T[:, :, None]
        out[thetas[:, 2] != 0.0, :25] = np.nan  # a clock that is off knows no first second
        return out

    late = replace(given, predict=predict)
    rows = StageRows(late, recordings((0.5, 0.0, 0.0), count=1), np.zeros(3), np.array([NOISE]))
    nominal_one, moved = rows.residuals(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]))
    assert not np.isnan(moved).any()
    assert (moved[:25] == nominal_one[:25]).all()
    assert not np.allclose(moved[25:], nominal_one[25:])


def test_sizes_are_counted_in_noise_floors() -> None:
    rows = rows_of((0.0, 0.0, 0.0))
    assert rows.in_floors(np.full((rows.count, 1), 0.3)) == pytest.approx([0.3 / NOISE])


def test_a_run_begins_anew_after_a_gap_of_its_command() -> None:
    plant = compile_plant(nominal())
    (recording, *_) = dataset_of(nominal(), 8.0).recordings
    table = recording.table.copy()
    table.loc[300:420, "slew.command"] = np.nan
    stage = drive_problem(plant, plant.machine.axis("slew"))
    rows = StageRows(stage, [replace(recording, table=table)], nominal().vector(), np.array([2e-4]))
    starts = np.flatnonzero(rows.series[0].restart) * rows.series[0].width
    assert len(starts) == 2
    assert starts[0] == 0
    assert 300 <= starts[1] <= 425


def test_activity_is_about_one_while_the_stage_moves() -> None:
    plant = compile_plant(nominal())
    dataset = dataset_of(nominal(), 8.0)
    rows = StageRows(drive_problem(plant, plant.machine.axis("slew")), dataset.recordings, nominal().vector(), np.array([2e-4]))
    activity = np.concatenate([s.activity for s in rows.series])
    assert np.sqrt(np.mean(activity**2)) == pytest.approx(1.0)
    assert activity.min() < 0.1


def ramp(count: int, kind: str = "motion") -> Recording:
    time = np.arange(count) / 100.0
    return Recording("run", pd.DataFrame({"time": time, "boom.joint": 2.0 * time}), 100.0, kind)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", [JOINT, TIP])
def test_stages_without_dynamics_are_averaged(kind: StageKind) -> None:
    width = round(STATIC_SPAN * 100.0)
    found = averaged(ramp(103), kind)
    assert found.rate_hz == pytest.approx(100.0 / width)
    assert len(found) == 103 // width
    assert found.values("boom.joint") == pytest.approx(2.0 * found.values("time"))
    assert found.values("time")[0] == pytest.approx((width - 1) / 200.0), "the mean time of the first samples"


def test_gaps_stay_gaps_where_less_than_half_is_there() -> None:
    made = ramp(100)
    table = made.table.copy()
    table.loc[0:6, "boom.joint"] = np.nan
    table.loc[10:13, "boom.joint"] = np.nan
    found = averaged(replace(made, table=table), JOINT).values("boom.joint")
    assert np.isnan(found).tolist() == [True] + [False] * 9


def test_stages_with_dynamics_and_poses_keep_their_rows() -> None:
    made, poses = ramp(100), ramp(100, "poses")
    assert averaged(made, TOOL) is made
    assert averaged(made, SPEED) is made
    assert averaged(made, FORCE) is made
    assert averaged(poses, TIP) is poses


def test_what_is_left_is_that_of_the_samples_whatever_is_averaged() -> None:
    """Noise that averages out is added back; the steps of a coarse sensor, which stay in the means, are not counted twice."""
    plant = compile_plant(nominal())
    stage = drive_problem(plant, plant.machine.axis("slew"))
    theta, floor = nominal().vector(), np.array([2e-4])
    given = dataset_of(nominal(), 40.0).recordings
    for step in (0.0, 4e-4):
        read = [replace(r, table=r.table.assign(**{"slew.joint": _read(r.values("slew.joint"), step)})) for r in given]
        rows = StageRows(stage, read, theta, floor, averaged_out(stage, read, theta, floor, 0.0))
        samples = np.concatenate([stage.measured(r)[:, 0] - stage.predict(theta[None], r)[0][:, 0] for r in read])
        found = rows.left(rows.residuals(theta[None])[0])
        assert found == pytest.approx(float(np.sqrt(np.nanmean((samples / floor) ** 2))), rel=0.1)


def _read(values: np.ndarray, step: float) -> np.ndarray:
    return values if step == 0.0 else np.round(values / step) * step


@pytest.mark.parametrize("kept", [0, 1_200, 64_000_000], ids=["nothing", "little", "everything"])
def test_residuals_that_are_known_are_those_of_a_prediction(kept: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many are kept; with those of one vector twice in a call, and although a caller changes what it got."""
    monkeypatch.setattr(rows_module, "KEPT", kept)
    asked: list[int] = []
    whole, seen = problem(), recordings((0.5, 0.0, 0.0))
    counting = replace(whole, predict=lambda thetas, r: [asked.append(len(thetas)), whole.predict(thetas, r)][1])  # type: ignore[func-returns-value]
    rows = StageRows(counting, seen, np.zeros(3), np.array([NOISE]))
    thetas = np.random.default_rng(0).normal(size=(5, 3))[[0, 1, 2, 1, 3, 0]]
    expected = [StageRows(whole, seen, np.zeros(3), np.array([NOISE])).residuals(theta[None])[0] for theta in thetas]
    for some in ([0, 1], [1, 2, 3], [3, 0, 4, 5], [2, 4]):
        asked.clear()
        found = rows.residuals(thetas[some])
        np.testing.assert_allclose(found, np.array(expected)[some], rtol=0.0, atol=1e-12)
        found[:] = np.nan
        for _, part in rows.residual_parts(thetas[some]):
            part[:] = np.nan
    assert sum(asked) == 0 or kept < 64_000_000
