"""What is flagged, what is not, and that nothing is changed by it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from sysid.datasets import Store, ingest
from sysid.datasets.channel import in_order
from sysid.datasets.checks.flag import MAX_FLAGS, Flag, SignalSamples, dropouts, jitter, repaired_stamps
from sysid.datasets.checks.run import KINDS, SENSOR_CHECKS
from sysid.datasets.checks.sensors import (
    SPIKE_SAMPLES,
    jumps,
    noise_scale,
    outliers,
    saturation,
    sensor_step,
    stuck,
)

Array = npt.NDArray[np.float64]
SIGMA = 1e-3


def command(seed: int, rate: float, seconds: float) -> Array:
    """Speeds a machine is asked for, a new one every two seconds; often none."""
    goals = np.random.default_rng(seed).choice([-0.3, 0.0, 0.0, 0.15, 0.3], round(seconds / 2.0) + 1)
    return np.repeat(goals, round(2.0 * rate))[: round(seconds * rate)]


def motion(seed: int, rate: float = 100.0, seconds: float = 60.0) -> tuple[Array, Array]:
    """A machine that stands, starts, stops and turns round, up to 0.3 /s, seen with noise of :data:`SIGMA`."""
    pole = np.exp(-1.0 / (0.08 * rate))
    speed = lfilter([1.0 - pole], [1.0, -pole], command(seed, rate, seconds))
    noise = SIGMA * np.random.default_rng(seed + 1).normal(size=len(speed))
    return np.arange(len(speed)) / rate, np.cumsum(speed) / rate + noise


def everything(times: Array, values: Array, commanded: Array) -> list[Flag]:
    samples = SignalSamples("a", times, values, limit_s=3.0 * (times[1] - times[0]))
    samples = replace(samples, commanded=np.abs(commanded) > 0.02, driven=np.abs(commanded) > 0.1)
    return [flag for check in (outliers, jumps, stuck, saturation, jitter, dropouts) for flag in check(samples)]


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), rate=st.sampled_from([20.0, 50.0, 100.0, 200.0, 1000.0]), step=st.sampled_from([0, 1, 3]))
def test_clean_sensors_are_not_flagged(seed: int, rate: float, step: int) -> None:
    """At any rate, continuous or counting in steps of one or three standard deviations of the noise."""
    times, values = motion(seed, rate, 30.0)
    if step:
        values = np.round(values / (step * SIGMA)) * step * SIGMA
    assert everything(times, values, command(seed, rate, 30.0)) == []


def test_a_noiseless_simulation_at_rest_is_not_stuck() -> None:
    times = np.arange(3000) / 100.0
    asked = np.where((times > 5.0) & (times < 12.0), 0.5, 0.0)
    assert everything(times, np.cumsum(0.1 * asked) / 100.0, asked) == []


@given(
    seed=st.integers(0, 10_000),
    length=st.integers(1, SPIKE_SAMPLES),
    size=st.floats(0.03, 5.0),
    up=st.booleans(),
    start=st.integers(100, 5000),
)
def test_spikes_of_a_few_samples_are_found_where_they_are(seed: int, length: int, size: float, up: bool, start: int) -> None:
    times, values = motion(seed)
    values[start : start + length] += size if up else -size
    (flag,) = outliers(SignalSamples("boom.joint", times, values, "rad"))
    assert (flag.signal, flag.kind, flag.samples) == ("boom.joint", "outlier", length)
    assert (flag.from_s, flag.to_s) == (times[start], times[start + length - 1])
    assert f"{'a sample' if length == 1 else f'{length} samples'} off by" in flag.text
    assert "rad" in flag.text
    assert [item for item in everything(times, values, command(seed, 100.0, 60.0)) if item.kind != "outlier"] == []


@pytest.mark.parametrize("from_end", range(1, 12))
def test_a_spike_near_either_end_is_found_or_left_alone(from_end: int) -> None:
    times, values = motion(3, seconds=20.0)
    for at in (len(values) - from_end, from_end - 1):
        spoiled = values.copy()
        spoiled[at] += 1.0
        found = outliers(SignalSamples("boom.joint", times, spoiled))
        assert all(flag.from_s == times[at] for flag in found)
        assert len(found) == (6 <= at < len(values) - 6)


@given(seed=st.integers(0, 10_000), size=st.floats(0.06, 3.0), start=st.integers(100, 3000), length=st.integers(20, 900))
def test_a_jump_and_the_one_back_are_one_flag(seed: int, size: float, start: int, length: int) -> None:
    times, values = motion(seed)
    values[start : start + length] += size
    (flag,) = jumps(SignalSamples("boom.joint", times, values, "rad"))
    assert (flag.from_s, flag.to_s, flag.samples) == (times[start], times[start + length - 1], length)
    assert "and back" in flag.text
    stays = motion(seed)[1]
    stays[start:] -= size
    (alone,) = jumps(SignalSamples("boom.joint", times, stays, "rad"))
    assert (alone.from_s, alone.samples) == (times[start], 1)


def test_a_turn_too_much_is_called_so() -> None:
    times, values = motion(3)
    values[2000:] -= 2.0 * np.pi
    (flag,) = jumps(SignalSamples("slew.joint", times, values, "rad"))
    assert flag.text.startswith("wraps by -6.28")


@given(seed=st.integers(0, 10_000), start=st.integers(500, 4000), length=st.integers(15, 400))
def test_a_sensor_with_noise_that_repeats_its_value_is_stuck(seed: int, start: int, length: int) -> None:
    times, values = motion(seed)
    values[start : start + length] = values[start]
    nowhere = np.zeros(len(times), dtype=bool)
    samples = SignalSamples("boom.joint", times, values, "rad", commanded=~nowhere, driven=nowhere)
    at_end = values[start] in (values.min(), values.max())
    (flag,) = (saturation if at_end else stuck)(samples)
    assert (flag.from_s, flag.to_s, flag.samples) == (times[start], times[start + length - 1], length)
    assert stuck(replace(samples, unit="1", commanded=nowhere)) == []


def test_a_counting_sensor_is_doubted_only_where_the_machine_has_to_move() -> None:
    times, values = motion(7)
    values = np.round(values / 0.004) * 0.004
    values[2000:2400] = values[2000]
    driven = np.zeros(len(times), dtype=bool)
    samples = SignalSamples("a", times, values, commanded=~driven, driven=driven)
    assert stuck(samples) == []
    driven[2100:2300] = True
    (flag,) = stuck(replace(samples, commanded=driven))
    assert flag.samples >= 400
    assert "a stuck sensor, or an axis that stalls" in flag.text


@pytest.mark.parametrize("step", [0.0, 0.004])
def test_a_sensor_whose_range_ends_is_saturated_and_an_end_stop_is_not(step: float) -> None:
    times = np.arange(6000) / 100.0
    values = np.sin(0.4 * times) + SIGMA * np.random.default_rng(0).normal(size=6000)
    if step:
        values = np.round(values / step) * step
    clipped = np.minimum(values, 0.7)
    always = np.ones(6000, dtype=bool)
    samples = SignalSamples("a", times, clipped, "m", commanded=always, driven=always, ends=(-2.0, 2.0))
    flags = saturation(samples)
    assert len(flags) == 4
    assert "stays at its highest value 0.7 m for" in flags[0].text
    assert flags[0].from_s == pytest.approx(np.arcsin(0.7) / 0.4, abs=0.05)
    if step:  # the axis ends there, or it is not known where it ends: nothing can be said
        assert saturation(replace(samples, ends=(-1.0, 0.7))) == []
        assert saturation(replace(samples, ends=(-np.inf, np.inf))) == []
    assert saturation(replace(samples, values=values)) == []


def test_what_is_not_bridged_is_a_dropout() -> None:
    times, values = motion(1)
    values[1000:1010] = np.nan
    kept = np.ones(len(times), dtype=bool)
    kept[3000:3100] = False
    samples = SignalSamples("a", times[kept], values[kept], limit_s=0.05)
    flags = dropouts(samples)
    assert [(f.from_s, f.to_s, f.samples) for f in flags] == [(9.99, 10.1, 10), (29.99, 31.0, 100)]
    assert flags[1].text == "no sample for 1.010 s"
    assert dropouts(replace(samples, limit_s=2.0)) == []


def test_uneven_stamps_are_flagged_once_and_a_gap_is_no_jitter() -> None:
    rng = np.random.default_rng(0)
    even = np.arange(1000) / 100.0
    assert jitter(SignalSamples("a", even + 1e-3 * rng.uniform(-1, 1, 1000), even)) == []
    assert jitter(SignalSamples("a", np.delete(even, np.arange(300, 500)), even)) == []
    (flag,) = jitter(SignalSamples("a", even + 4e-3 * rng.uniform(-1, 1, 1000), even))
    assert flag.from_s == pytest.approx(0.0, abs=5e-3)
    assert flag.samples > 200
    assert "nine intervals in ten lie between" in flag.text


def test_stamps_that_go_back_or_repeat_are_told() -> None:
    stamps = np.arange(100, dtype=np.int64) * 10_000_000
    assert repaired_stamps("a", stamps) == []
    stamps[50], stamps[51] = stamps[51], stamps[50]
    stamps[80] = stamps[79]
    (flag,) = repaired_stamps("a", stamps)
    assert (flag.samples, flag.from_s, flag.to_s) == (2, 0.5, 0.79)
    assert flag.text == "1 stamps go back, by up to 10.000 ms: sorted; 1 rows have the stamp of another: dropped"
    order, late = in_order(stamps, "here")
    assert (len(order), late) == (99, 1)


def test_many_flags_of_a_kind_are_told_as_one() -> None:
    times, values = motion(2)
    values[200:5800:100] += 1.0
    (flag,) = outliers(SignalSamples("a", times, values))
    assert flag.samples == 56 > MAX_FLAGS
    assert flag.text.startswith("56 times, 56 samples in all; the longest at ")


@given(sigma=st.floats(1e-6, 1e-1), seed=st.integers(0, 1000))
def test_the_scale_of_the_noise_and_the_step_of_a_counter(sigma: float, seed: int) -> None:
    noise = sigma * np.random.default_rng(seed).normal(size=2000)
    assert noise_scale(noise) == pytest.approx(sigma, rel=0.12)
    assert sensor_step(noise) == 0.0
    counts = np.cumsum(np.random.default_rng(seed).integers(-3, 4, 2000)) * 2 * np.pi / 4096 + 0.123
    assert sensor_step(counts) == pytest.approx(2 * np.pi / 4096, rel=1e-6)


def test_a_flagged_recording_keeps_every_raw_value_and_stamp(tmp_path: Path) -> None:
    """Bit by bit, on the device's own clock; the flags name the samples on the recording's time axis."""
    (tmp_path / "machine.toml").write_text(
        'schema = 1\nname = "press"\nrate_hz = 100.0\n[[axes]]\nname = "ram"\nactuation = "velocity"\ndrives = "joint"\n'
        "limits = [-9.0, 9.0]\n"
    )
    times, values = motion(4)
    asked = command(4, 100.0, 60.0)
    values[1500] += 0.5
    values[3100:3180] = values[3100]
    values[4000:4300] += 2.0
    values[5000:5030] = np.nan
    stamps = np.rint(times * 1e9).astype(np.int64) + 1_700_123_456_789
    (tmp_path / "logs/run").mkdir(parents=True)
    frame = pd.DataFrame({"time [ns]": stamps, "ram.command": asked, "ram.joint [rad]": values})
    frame.to_parquet(tmp_path / "logs/run/log.parquet")
    made = ingest(tmp_path / "logs", tmp_path / "ws", machine=tmp_path / "machine.toml")
    raw = Store(tmp_path / "ws").channels(made.reference)
    joint = raw[raw["signal"] == "ram.joint"]
    there = ~np.isnan(values)  # a row without a value is no sample
    np.testing.assert_array_equal(joint["stamp_ns"].to_numpy(), stamps[there])
    assert joint["value"].to_numpy(dtype=np.float64).tobytes() == values[there].tobytes()
    rows = made.quality["flags"]
    assert [(row["signal"], row["kind"], row["samples"]) for row in rows] == [
        ("ram.joint", "outlier", 1),
        ("ram.joint", "jump", 1),  # where the stuck sensor is back
        ("ram.joint", "jump", 300),
        ("ram.joint", "stuck", 80),
        ("ram.joint", "dropout", 30),
    ]
    np.testing.assert_allclose([row["from_s"] for row in rows], [15.0, 31.8, 40.0, 31.0, 49.99], atol=1e-9)
    table = np.concatenate([recording.values("ram.joint") for recording in made.recordings])
    assert np.nanmin(np.abs(table - values[1500])) < 1e-9  # it stays in the table


def test_kinds_are_complete() -> None:
    """Every detector says one of the kinds that the documentation lists."""
    text = (Path(__file__).parents[2] / "docs/recipes.md").read_text("utf-8")
    listed = text[text.index("| `kind` |") :].splitlines()[0]
    assert [word.strip("`, ") for word in listed.split("|")[2].split()] == list(KINDS)
    by_checks = {kind for kinds in SENSOR_CHECKS.values() for kind in kinds}
    assert {*KINDS} - by_checks == {"sentinel", "marker_swap", "stamps"}, "those are found while reading"
    assert by_checks <= {*KINDS}
