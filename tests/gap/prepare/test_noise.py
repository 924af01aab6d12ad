"""The noise of every signal: robust against motion, steps and poses, and never the motion itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plant_data import arm, dataset_of, nominal

from sysid.datasets import ingest
from sysid.datasets.quality.noise import noise_of, white_noise
from sysid.datasets.recording import Dataset, Recording
from sysid.gap import find_gap
from sysid.gap.prepare.noise import PLAUSIBLE, noise_levels
from sysid.gap.prepare.resolution import coarse_sensors, reading_step, rounding
from sysid.machine import KnownEffect, Machine
from sysid.plant import nominal_plant

Array = npt.NDArray[np.float64]


def silent() -> Machine:
    """The arm without a data sheet."""
    return replace(arm(), noise={})


def with_signal(values: Array, rate_hz: float, signal: str = "slew.joint") -> Dataset:
    table = pd.DataFrame({"time": np.arange(len(values)) / rate_hz, signal: values})
    return Dataset.of(silent(), [Recording("run", table, rate_hz)])


def multisine(time: Array, seed: int, fastest: float = 1.0) -> Array:
    rng = np.random.default_rng(seed)
    parts = [(f * fastest, rng.uniform(0.2, 0.5), rng.uniform(0.0, 6.28)) for f in (0.2, 0.6, 1.0)]
    return np.asarray(sum(a * np.sin(2.0 * np.pi * f * time + p) for f, a, p in parts))


@settings(deadline=None)
@given(st.sampled_from([20.0, 50.0, 100.0, 500.0]), st.floats(1e-5, 1e-2), st.integers(0, 100))
def test_noise_is_separated_from_motion_at_any_rate(rate_hz: float, sigma: float, seed: int) -> None:
    """Also where a cubic over a fifth of a second, or ten samples, cannot follow the motion: within 0.75 and 3.5 times."""
    time = np.arange(0.0, 60.0, 1.0 / rate_hz)
    values = multisine(time, seed) + sigma * np.random.default_rng(seed).normal(size=len(time))
    assert 0.75 * sigma < white_noise(values, rate_hz) < 3.5 * sigma


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 20.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_motion_that_is_too_fast_for_the_rate_is_no_noise(rate_hz: float, seed: int) -> None:
    """Up to the sampling limit: the figure stays a plausible share of the range."""
    time = np.arange(0.0, 60.0, 1.0 / rate_hz)
    values = multisine(time, seed, fastest=0.35 * rate_hz) + 1e-4 * np.random.default_rng(seed).normal(size=len(time))
    assert noise_levels(with_signal(values, rate_hz))["slew.joint"] <= PLAUSIBLE * np.ptp(values)


def test_static_poses_are_no_samples_of_a_motion() -> None:
    """What ingest says of a table of a dozen poses is their range; poses that repeat tell the noise."""
    rng, count = np.random.default_rng(0), 12
    places = {name: rng.uniform(-0.4, 0.4, count) for name in ("slew.joint", "boom.joint", "wrist.joint")}
    table = pd.DataFrame({"time": 5.0 * np.arange(count), **places})
    quality = {
        "recordings": {"poses": {"signals": {name: {"noise": noise_of(values, 0.2)} for name, values in places.items()}}}
    }
    dataset = replace(Dataset.of(silent(), [Recording("poses", table, 0.2, "poses")]), quality=quality)
    for name, values in places.items():
        assert noise_levels(dataset)[name] < 0.01 * np.ptp(values), name
    again = pd.concat([table] * 3, ignore_index=True)
    again["boom.joint"] += 2e-3 * rng.normal(size=len(again))
    repeated = replace(dataset, recordings=(Recording("poses", again, 0.2, "poses"),), quality={})
    assert noise_levels(repeated)["boom.joint"] == pytest.approx(2e-3, rel=0.4)


@given(st.sampled_from([0.0, 1e-4, 0.3, -1.2]), st.integers(0, 100))
def test_an_axis_that_stands_still_reads_in_no_steps(place: float, seed: int) -> None:
    """Rounding of floating-point numbers is neither a step nor noise."""
    dust = np.random.default_rng(seed).integers(-2, 3, 3000) * max(2.0**-52 * abs(place), 1.1e-16)
    dataset = with_signal(place + dust, 100.0)
    assert reading_step([place + dust]) == 0.0
    assert noise_levels(dataset)["slew.joint"] > 1e-9
    assert coarse_sensors(nominal_plant(silent()), dataset.recordings, noise_levels(dataset)) == ()


@pytest.mark.parametrize("share", [15.0, 6.0])
def test_steps_of_many_times_the_noise_are_found_without_a_data_sheet(share: float) -> None:
    step = 3e-3
    time = np.arange(0.0, 60.0, 0.01)
    said = multisine(time, 1) + step / share * np.random.default_rng(0).normal(size=len(time))
    dataset = with_signal(step * np.round(said / step), 100.0)
    levels = noise_levels(dataset)
    (coarse,) = coarse_sensors(nominal_plant(silent()), dataset.recordings, levels)
    assert coarse.step == pytest.approx(step, rel=1e-6)
    assert coarse.noise < rounding(step)
    assert levels["slew.joint"] == pytest.approx(rounding(step), rel=0.3)


@pytest.mark.parametrize("decimals", [4, 5])
def test_numbers_written_with_few_digits_are_no_steps_of_a_sensor(decimals: int) -> None:
    """The readings lie on a lattice, but the noise in them is larger than its steps."""
    time = np.arange(0.0, 60.0, 0.01)
    values = np.round(multisine(time, 2) + 2e-4 * np.random.default_rng(0).normal(size=len(time)), decimals)
    dataset = with_signal(values, 100.0)
    assert reading_step([values]) == pytest.approx(10.0**-decimals, rel=1e-6)
    assert coarse_sensors(nominal_plant(silent()), dataset.recordings, noise_levels(dataset)) == ()


@settings(deadline=None, max_examples=30)
@given(st.floats(1e-4, 1e-2), st.floats(-0.01, 0.01), st.integers(0, 50))
def test_the_zero_of_a_lattice_does_not_matter(step: float, zero: float, seed: int) -> None:
    time = np.arange(0.0, 30.0, 0.01)
    assert reading_step([zero + step * np.round(multisine(time, seed) / step)]) == pytest.approx(step, rel=1e-5)


@given(st.floats(1e-3, 1e-2), st.floats(0.0, 0.19), st.integers(0, 50))
@settings(deadline=None, max_examples=30)
def test_the_step_is_no_fraction_of_the_true_one(step: float, noise: float, seed: int) -> None:
    """A sensor of few steps a turn, read by a faster table: noise after the rounding, up to a fifth of the step."""
    time = np.arange(0.0, 60.0, 0.01)
    readings = step * np.round(multisine(time, seed) / step) + noise * step * np.random.default_rng(seed).normal(size=len(time))
    assert reading_step([readings]) == pytest.approx(step, rel=1e-3)


def test_steps_are_named_where_the_machine_has_no_data_sheet() -> None:
    truth = nominal(KnownEffect("sensor_quantisation", "boom.joint", {"step": 5e-3}))
    dataset = dataset_of(truth, 20.0)
    assert {e.name for e in find_gap(replace(dataset, machine=silent()), nominal(machine=silent())).effects} == {
        "sensor_quantisation"
    }


def recorded(shared_data: Path, folder: Path, name: str) -> Dataset:
    source = shared_data / {"so101": "sage_so101/friction_gravity"}.get(name, name)
    if not source.exists():
        pytest.skip(f"no recordings of {name} beside the repository")
    return ingest(source, folder, recipe=Path(__file__).parents[3] / "datasets" / name / "recipe.toml")


@pytest.mark.parametrize(
    ("name", "steps"),
    [
        pytest.param("emps", {}, marks=pytest.mark.slow),
        pytest.param("rc_excavator", {}, marks=pytest.mark.slow),
        ("so101", {"elbow.joint": 2.0 * np.pi / 4096}),
    ],
)
def test_recordings_of_real_machines(name: str, steps: dict[str, float], shared_data: Path, tmp_path: Path) -> None:
    """Noise is a small share of every range; a servo of 4096 counts a turn reads in those, the others in no steps that show."""
    dataset = recorded(shared_data, tmp_path, name)
    unsaid = replace(dataset, machine=replace(dataset.machine, noise={}))
    levels = noise_levels(unsaid)
    for signal, level in levels.items():
        values = np.concatenate([r.values(signal) for r in dataset.recordings])
        assert 0.0 < level <= PLAUSIBLE * (np.nanmax(values) - np.nanmin(values)), signal
        if signal in dataset.machine.noise:
            specified = dataset.machine.noise[signal]  # slower noise and vibration included
            assert 0.1 * specified < level < 1.6 * specified, signal
    for signal, step in steps.items():
        assert reading_step([r.values(signal) for r in dataset.of_kind("motion")]) == pytest.approx(step, rel=1e-3)
    found = coarse_sensors(nominal_plant(unsaid.machine), dataset.recordings, levels)
    assert {item.signal for item in found} <= {s for s in levels if name == "so101"}


@pytest.mark.parametrize("rate_hz", [20.0, 100.0, 500.0])
def test_the_noise_estimate_is_unbiased(rate_hz: float) -> None:
    """The median over many recordings of white noise on a slow motion, also with few degrees of freedom a window (20 Hz)."""
    time = np.arange(0.0, 60.0, 1.0 / rate_hz)
    draws = [multisine(time, k) + 1e-3 * np.random.default_rng(k).normal(size=len(time)) for k in range(40)]
    assert np.median([white_noise(values, rate_hz) for values in draws]) == pytest.approx(1e-3, rel=0.03)


def test_a_servo_that_moves_in_half_a_second_at_a_low_rate_is_not_free_of_noise() -> None:
    """Interpolated counts at 10 Hz: still most of the time, and otherwise too fast for any polynomial."""
    move = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0.1, 1.0, 6))
    to, fro = np.concatenate([move, np.ones(15)]), np.concatenate([1.0 - move, np.zeros(15)])
    values = 2.7 + 0.6 * np.concatenate([np.zeros(15), *(to, fro) * 3])
    level = noise_levels(with_signal(values, 10.0))["slew.joint"]
    assert level == pytest.approx(PLAUSIBLE * 0.6, rel=0.01)
