"""A residual that no effect explains is described where it depends on a variable, and reported as random where it does not."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from unnamed_data import (
    MACHINE,
    MODEL,
    PERIOD,
    Rate,
    disturbed,
    heavy,
    nothing,
    pulsing,
    ripple,
    swelling,
    white,
)

from sysid.datasets.recording import Recording
from sysid.gap.problem import Problem, drive_problem, joint_problem
from sysid.gap.result import Unnamed
from sysid.gap.unnamed.description import NOTHING, cross_correlations, describe, describe_residual
from sysid.gap.unnamed.formula import Formula, find_formula
from sysid.gap.unnamed.residual_series import BIN, PARTS, Factor, ResidualSeries, Term, quasi_difference, residual_series

Array = npt.NDArray[np.float64]
DRIVE, JOINT = drive_problem(MODEL, MACHINE.axis("boom")), joint_problem(MODEL, MACHINE.axis("boom"))


def recordings(rate: Rate, seed: int = 0, seconds: float = 30.0) -> list[Recording]:
    return [disturbed(f"run-{k}", rate, 10 * seed + k, seconds) for k in range(3)]


def described(problem: Problem, seen: Sequence[Recording]) -> Unnamed:
    (found,) = describe_residual(problem, MODEL.theta, seen, MACHINE)
    return found


def test_a_ripple_along_the_cylinder_is_found_with_its_period() -> None:
    found = described(DRIVE, recordings(ripple))
    assert found.depends_on == "boom.cylinder, speed of boom"
    assert found.period == pytest.approx(PERIOD, rel=0.02)
    assert found.period_unit == "m"
    assert found.explains > 0.9
    assert found.form.startswith("rate of the residual of boom.cylinder ≈ 0.")
    assert re.search(
        r"0\.(1|09\d*|10\d*)·sin\(2π·boom\.cylinder/0\.0(3|299\d|300\d) \+ 0\.[45]\d\)·speed of boom \(SI", found.form
    )


def test_a_term_of_load_and_speed_is_found() -> None:
    found = described(DRIVE, recordings(heavy))
    assert found.depends_on == "load of boom, speed of boom"
    assert "−0.50" in found.form or "−0.5·" in found.form or "−0.49" in found.form
    assert "load of boom·speed of boom·|speed of boom|" in found.form
    assert found.explains > 0.9
    assert found.period == 0.0


def test_a_periodic_disturbance_has_one_period_and_a_phase_per_recording() -> None:
    found = described(DRIVE, recordings(pulsing))
    assert found.depends_on == "time, speed of boom"
    assert found.period == pytest.approx(1.0 / 0.7, rel=0.02)
    assert found.period_unit == "s"
    assert "with one phase φ per recording" in found.form


@pytest.mark.parametrize("rate", [nothing, white, swelling])
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_a_random_disturbance_depends_on_nothing(rate: Rate, seed: int) -> None:
    """White in speed is a random walk in position."""
    found = described(DRIVE, recordings(rate, seed))
    assert (found.depends_on, found.explains, found.period) == (NOTHING, 0.0, 0.0)
    assert "it looks like a random disturbance of about" in found.form
    if rate is swelling:
        share = float(found.form.split("about ")[1].split(" %")[0])
        assert 3.0 < share < 7.0, "5 % of the speed, less what the bins average away"


def drifting(recording: Recording, seed: int, step: float) -> Recording:
    walk = np.cumsum(np.random.default_rng([seed, 11]).normal(0.0, step, len(recording)))
    return replace(recording, table=recording.table.assign(**{"boom.joint": recording.values("boom.joint") + walk}))


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_a_drifting_sensor_depends_on_nothing(seed: int) -> None:
    """A stage that does not integrate: position and load drift as well, so plain correlations are large by chance."""
    seen = [drifting(r, 10 * seed + k, 2e-4) for k, r in enumerate(recordings(nothing, seed))]
    found = described(JOINT, seen)
    assert found.depends_on == NOTHING
    assert "a random drift" in found.form


def test_an_uneven_linkage_is_found_although_the_sensor_drifts() -> None:
    seen = []
    for k, recording in enumerate(recordings(nothing)):
        bent = 0.01 * np.sin(2.0 * np.pi * recording.values("boom.cylinder") / 0.05)
        table = recording.table.assign(**{"boom.joint": recording.values("boom.joint") + bent})
        seen.append(drifting(replace(recording, table=table), k, 5e-5))
    found = described(JOINT, seen)
    assert found.depends_on == "boom.cylinder"
    assert found.period == pytest.approx(0.05, rel=0.02)
    assert found.form.startswith(("residual of boom.joint ≈ 0.01", "residual of boom.joint ≈ 0.009"))


def test_the_same_recordings_are_described_the_same() -> None:
    seen = recordings(ripple, 4)
    assert described(DRIVE, seen) == described(DRIVE, seen)


def test_short_recordings_say_so() -> None:
    found = described(DRIVE, [disturbed("run-0", ripple, 0, 1.0)])
    assert (found.depends_on, found.form) == (NOTHING, "measured for too short a time to describe it")


def test_a_rate_and_its_terms_pass_the_same_filter() -> None:
    """A term whose integral is the residual meets it without attenuation, however short its period."""
    recording = recordings(nothing)[0]
    x = recording.values("boom.cylinder")
    term = Term((Factor("sin", "boom.cylinder", 0.01), Factor("identity", "speed of boom")))
    extra = -0.01 / (2.0 * np.pi) * np.cos(2.0 * np.pi * x / 0.01)  # ∫ sin(2πx/P) dx
    table = recording.table.assign(**{"boom.cylinder": x + 0.2 * extra})
    series = residual_series(DRIVE, MODEL.theta, replace(recording, table=table), MACHINE, 0)
    assert series is not None
    column = term.column(series)
    assert float(column @ series.target / (column @ column)) == pytest.approx(0.2, rel=0.06)


def test_correlations_allow_for_autocorrelation_and_lag() -> None:
    rng = np.random.default_rng(3)
    count = 3000
    drive = np.convolve(rng.standard_normal(count + 20), np.ones(20) / 20.0, mode="valid")[:count]  # autocorrelated
    noise = np.convolve(rng.standard_normal(count + 20), np.ones(20) / 20.0, mode="valid")[:count]
    late = np.concatenate([np.zeros(4), drive[:-4]])

    def series(target: Array) -> ResidualSeries:
        parts = {"drive": np.repeat(drive, PARTS), "other": np.repeat(np.cumsum(rng.standard_normal(count)), PARTS)}
        return ResidualSeries("run", target, parts, False, BIN)

    followed = cross_correlations([series(noise + late)], 0.9)
    assert followed[0].name == "drive"
    assert followed[0].lag == pytest.approx(4 * BIN)
    assert abs(followed[0].correlation) > 2.0 * followed[0].bound
    alone = cross_correlations([series(noise)], 0.9)
    assert all(abs(p.correlation) < p.bound for p in alone)
    plain = np.corrcoef(noise, drive)[0, 1]
    assert 3.0 / np.sqrt(count) < max(abs(plain), alone[0].bound), "the bound of a white residual is too narrow here"


def test_bounds_hold_for_a_disturbance_whose_variance_depends_on_the_variable() -> None:
    false_alarms = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        motion = np.convolve(rng.standard_normal(1019), np.ones(20), mode="valid")
        series = ResidualSeries("run", motion * rng.standard_normal(1000), {"motion": np.repeat(motion, PARTS)}, False, BIN)
        (probe,) = cross_correlations([series], 0.0)
        false_alarms += abs(probe.correlation) > probe.bound
    assert false_alarms <= 3, "one in a hundred, all lags together"


def test_a_formula_as_text_and_as_prediction() -> None:
    terms = (
        Term((Factor("sin", "x", 0.5), Factor("abs", "v"))),
        Term((Factor("cos", "x", 0.5), Factor("abs", "v"))),
        Term((Factor("offset", "load", 3.0), Factor("identity", "v"))),
    )
    formula = Formula(terms, (0.3, -0.4, -2.0), 0.1)
    assert str(formula) == "0.5·sin(2π·x/0.5 − 0.93)·|v| − 2·(load − 3)·v"
    rng = np.random.default_rng(0)
    parts = {name: rng.standard_normal(20) for name in ("x", "v", "load")}
    series = ResidualSeries("run", np.zeros(10), parts, False, BIN)
    x, v, load = (parts[name] for name in ("x", "v", "load"))
    fine = 0.5 * np.sin(2.0 * np.pi * x / 0.5 - np.arctan2(0.4, 0.3)) * np.abs(v) - 2.0 * (load - 3.0) * v
    assert np.allclose(formula.predict(series), 0.1 + fine.reshape(-1, 2).mean(axis=1))


def test_a_random_walk_has_no_share_on_left_out_recordings() -> None:
    """In-sample, sixty columns and a search of periods explain a part of anything."""
    rng = np.random.default_rng(7)
    series = []
    for k in range(3):
        walks = {name: np.repeat(np.cumsum(rng.standard_normal(300)), PARTS) for name in ("a", "b", "load of c")}
        series.append(ResidualSeries(f"run-{k}", np.cumsum(rng.standard_normal(300)), walks, False, BIN))
    found = find_formula(series, ("a",))
    assert found.share < 0.05
    assert found.ar1 > 0.9


def test_quasi_differences_are_white_for_the_right_coefficient() -> None:
    rng = np.random.default_rng(1)
    x = np.zeros(5000)
    for k in range(1, 5000):
        x[k] = 0.8 * x[k - 1] + rng.standard_normal()
    y = quasi_difference(x, 0.8)
    assert abs(np.corrcoef(y[1:], y[:-1])[0, 1]) < 0.04


def test_recordings_with_different_signals_share_a_formula() -> None:
    rng = np.random.default_rng(3)
    series = []
    for k in range(3):
        speed = np.repeat(np.sin(0.05 * np.arange(400)), PARTS)
        extra = {"load of boom": rng.standard_normal(len(speed))} if k == 0 else {}
        series.append(
            ResidualSeries(
                f"run-{k}", speed[::PARTS] + 0.1 * rng.standard_normal(400), {**extra, "speed of boom": speed}, False, BIN
            )
        )
    found = find_formula(series, ["load of boom"])
    assert found.share > 0.5
    assert all("load" not in name for term in found.formula.terms for name in term.variables)


def test_a_series_too_short_for_cross_validation_has_no_formula() -> None:
    motion = np.repeat(np.sin(0.1 * np.arange(70)), PARTS)
    found = find_formula([ResidualSeries("run", motion[::PARTS], {"speed of slide": motion}, False, BIN)], [])
    assert (found.formula.terms, found.share, found.p_value) == ((), 0.0, 1.0)


def test_recordings_without_motion_of_the_axis_are_skipped() -> None:
    seen = recordings(swelling)
    still = seen[2].table.assign(**{"boom.command": 0.0, "boom.cylinder": seen[2].table["boom.cylinder"].iloc[0]})
    found = described(DRIVE, [*seen[:2], replace(seen[2], table=still)])
    assert "speed" in f"{found.depends_on} {found.form}"


@pytest.mark.parametrize("seconds", [1.0, 2.0, 4.0, 8.0])
def test_short_recordings_are_described_or_left(seconds: float) -> None:
    """Too few rows for a correlation are no correlation."""
    for found in describe_residual(DRIVE, MODEL.theta, recordings(white, seconds=seconds), MACHINE):
        assert found.form
        assert np.isfinite(found.rmse)


def test_a_residual_beside_which_nothing_varies_is_random() -> None:
    whole = [residual_series(DRIVE, MODEL.theta, recording, MACHINE, 0) for recording in recordings(white)]
    steady = [replace(part, variables={}) for part in whole if part is not None]
    found = describe(DRIVE, 1.0, "boom.cylinder", steady, MACHINE)
    assert (found.depends_on, found.probes) == (NOTHING, ())


@pytest.mark.parametrize("short", [0, 1, 3, 30])
def test_a_recording_shorter_than_the_longest_lag_says_nothing_about_it(short: int) -> None:
    rng = np.random.default_rng(5)

    def series(count: int) -> ResidualSeries:
        parts = {"drive": np.repeat(rng.standard_normal(count), PARTS)}
        return ResidualSeries("run", rng.standard_normal(count), parts, False, BIN)

    long = series(500)
    (alone,), (both,) = cross_correlations([long], 0.3), cross_correlations([long, series(short)], 0.3)
    assert abs(both.correlation - alone.correlation) < 0.2
