"""The measured input of a stage: the smoother is exact, its estimate is near the truth, backlash behind it has its width."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_data import dataset_of, nominal

from sysid.datasets import Recording
from sysid.gap.candidates import candidates_at
from sysid.gap.data import Data
from sysid.gap.drift import DriftStrength, smooth_level
from sysid.gap.fit import fit_candidates
from sysid.gap.prepare.measured_input import MeasuredInput, with_measured_input
from sysid.gap.problem import problems_of
from sysid.machine import KnownEffect
from sysid.plant import Plant, compile_plant, free_run

Array = npt.NDArray[np.float64]

CYLINDER = "boom.cylinder"
WIDTH = 0.02


@given(st.integers(0, 10_000), st.sampled_from([0.0, 1e-3, 0.3]), st.sampled_from([0.0, 0.02, 2.0]))
def test_the_level_is_the_mean_given_all_samples(seed: int, calm: float, moving: float) -> None:
    """Against the covariance of level and samples, inverted as a whole."""
    rng = np.random.default_rng(seed)
    activity = rng.uniform(0.0, 2.0, 40)
    activity /= activity.mean()
    residual = np.cumsum(np.sqrt(calm + moving * activity) * rng.standard_normal(40)) + rng.standard_normal(40)
    residual[rng.random(40) < 0.2] = np.nan
    there = ~np.isnan(residual)
    steps = np.concatenate([[1.0], calm + moving * activity[:-1]])  # the level begins as uncertain as one sample
    level = np.minimum.outer(np.arange(40), np.arange(40))
    covariance = np.cumsum(steps)[level]
    gain = covariance[np.ix_(there, there)] @ np.linalg.inv(covariance[np.ix_(there, there)] + np.eye(int(there.sum())))
    found = smooth_level(residual, activity, DriftStrength(calm, moving))
    assert found[there] == pytest.approx(gain @ residual[there], abs=1e-8)
    assert np.isnan(found[~there]).all()


def noisy(plant: Plant, noise: float, seed: int = 3) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Recordings of a plant with this noise of its cylinder [m], and the same without."""
    exact = [r for r in dataset_of(plant, 20.0, seed, 0.0).recordings if r.kind == "motion"]
    rng = np.random.default_rng(seed)
    added = [{CYLINDER: r.values(CYLINDER) + noise * rng.standard_normal(len(r))} for r in exact]
    return tuple(replace(r, table=r.table.assign(**each)) for r, each in zip(exact, added, strict=True)), tuple(exact)


def error(found: Recording, exact: Recording) -> float:
    return float(np.sqrt(np.nanmean((found.values(CYLINDER) - exact.values(CYLINDER)) ** 2)))


@pytest.mark.parametrize(("gain", "share"), [(1.0, 0.1), (0.97, 0.35), (0.5, 0.7)])
def test_the_estimate_is_nearer_than_the_samples_whatever_the_simulation_lacks(gain: float, share: float) -> None:
    machine = nominal().with_effect(KnownEffect("gain_error", "boom", {"ratio": gain}))
    model, noise = compile_plant(nominal()), 1e-3
    samples, exact = noisy(machine, noise)
    estimate = MeasuredInput((CYLINDER,), {CYLINDER: noise}, lambda recording: free_run(model, recording))
    assert max(error(estimate(r), e) for r, e in zip(samples, exact, strict=True)) < share * noise
    alone = MeasuredInput((CYLINDER,), {CYLINDER: noise})
    assert max(error(alone(r), e) for r, e in zip(samples, exact, strict=True)) < 0.7 * noise, "without a simulation"


def test_what_cannot_be_estimated_stays_as_it_is() -> None:
    (recording, *_), _ = noisy(nominal(), 1e-3)
    poses = replace(recording, kind="poses")
    assert MeasuredInput((CYLINDER,), {CYLINDER: 1e-3})(poses) is poses
    assert MeasuredInput((CYLINDER,), {})(recording) is recording
    assert MeasuredInput(("stick.angle",), {"stick.angle": 1.0})(recording) is recording
    gap = recording.table.copy()
    gap.loc[100:200, CYLINDER] = np.nan
    found = MeasuredInput((CYLINDER,), {CYLINDER: 1e-3})(replace(recording, table=gap))
    assert np.isnan(found.values(CYLINDER)).tolist() == gap[CYLINDER].isna().tolist()
    few = recording.table.assign(**{CYLINDER: np.where(np.arange(len(recording)) < 20, recording.values(CYLINDER), np.nan)})
    kept = MeasuredInput((CYLINDER,), {CYLINDER: 1e-3})(replace(recording, table=few)).values(CYLINDER)
    assert np.array_equal(kept, few[CYLINDER].to_numpy(), equal_nan=True)


@pytest.mark.parametrize("ratio", [2.0, 5.0, 20.0])
def test_backlash_behind_a_noisy_sensor_has_its_width(ratio: float) -> None:
    plant, model = nominal(), compile_plant(nominal())
    machine = plant.with_effect(KnownEffect("backlash", "boom", {"width": WIDTH}, "drive"))
    linkage = plant.linkages["boom"]
    _, exact = noisy(machine, 0.0)
    path = exact[0].values(CYLINDER)
    slope = abs(float(np.polyfit(path, linkage.joint(path), 1)[0]))
    noise = WIDTH / slope / ratio
    samples, _ = noisy(machine, noise)
    raw = next(p for p in problems_of(model, dataset_of(plant, 20.0)) if (p.stage, p.target) == ("joint", "boom"))
    problem = with_measured_input(raw, {CYLINDER: noise}, lambda recording: free_run(model, recording))
    offered = candidates_at(plant, model.theta, problem.kind.stages, ("boom",))
    candidate = next(c for c in offered if c.effect.name == "backlash" and c.side == "drive")

    def width(driven: object) -> float:
        data = Data(driven, samples, np.array([1e-4]))  # type: ignore[arg-type]
        return float(fit_candidates(data, model.theta, [candidate], [np.array([w]) for w in (0.01, 0.03)]).values[0])

    assert width(problem) == pytest.approx(WIDTH, rel=0.05)
    assert width(raw) > 1.1 * WIDTH, "noise of its input widens it"
