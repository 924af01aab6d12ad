"""Irregular drives and closed-loop work: each does what it says, and both are absent unless a recipe asks for them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simulated_bench import AXES, BenchRecipe, RecordingSettings, load_recipe
from simulated_bench.cylinder import drive_of, position_of
from simulated_bench.flight import draw_flight, flight_command
from simulated_bench.irregular import IrregularSettings, flow_share, irregular_of
from simulated_bench.joint_recipe import ServoArm, ServoAxis, Slide, Take
from simulated_bench.machine import Truth, run_machine
from simulated_bench.servo_arm import run_servo_arm
from simulated_bench.slide import run_slide
from sysid.errors import SettingsError

TAKE = RecordingSettings("take", seed=3, seconds=12.0)
FLIGHT = RecordingSettings("flight", seed=4, seconds=40.0, program="flight")


def irregular(recipe: BenchRecipe, **settings: float) -> BenchRecipe:
    boom = replace(recipe.axis("boom"), irregular=IrregularSettings(**settings))
    return replace(recipe, axes={**recipe.axes, "boom": boom})


def run(recipe: BenchRecipe, take: RecordingSettings = TAKE) -> Truth:
    return run_machine(recipe, take, np.random.default_rng(5))


def speed(truth: Truth) -> np.ndarray:
    return np.diff(truth.drive[:, AXES.index("boom")]) / 1e-3


def test_share_of_the_flow_by_place_time_opening_and_work() -> None:
    def share(opening: float, position: float, time: float, held: float = 0.0, **settings: float) -> tuple[float, float]:
        return flow_share(opening, position, time, held, irregular_of(IrregularSettings(**settings)), 1e-3)

    assert share(0.8, 0.3, 2.0) == (1.0, 0.0)
    assert share(0.8, 0.01, 0.0, uneven=0.1, pitch=0.04)[0] == pytest.approx(1.1)
    assert share(0.8, 0.0, 0.25, ripple=0.2, ripple_frequency=3.0)[0] == pytest.approx(0.8)
    assert [share(u, 0.0, 0.0, slip=0.3, slip_above=0.5)[0] for u in (0.4, 0.6, -0.6)] == pytest.approx([1.0, 0.7, 0.7])
    held = 0.0
    for _ in range(4000):
        tired, held = share(-1.0, 0.0, 0.0, held, fade=0.2, fade_time=2.0)
    assert held == pytest.approx(1.0 - np.exp(-2.0), rel=1e-3)
    assert tired == pytest.approx(1.0 - 0.2 * held, rel=1e-3)


def test_irregular_drive_moves_as_its_share_says(recipe: BenchRecipe) -> None:
    """Nothing else of the axis changes: where the valve is closed it stands still all the same."""
    regular, rippled = run(recipe), run(irregular(recipe, ripple=0.1, ripple_frequency=3.0))
    moving = np.abs(speed(regular)[:6000]) > 1e-4
    ratio = speed(rippled)[:6000][moving] / speed(regular)[:6000][moving]
    expected = 1.0 + 0.1 * np.sin(2.0 * np.pi * 3.0 * regular.time[:6000][moving])
    assert ratio == pytest.approx(expected, abs=1e-6)
    assert (rippled.drive[:, 0] == regular.drive[:, 0]).all()


def test_flight_follows_its_path_by_commands_that_jump_the_overlap(recipe: BenchRecipe) -> None:
    truth = run(recipe, FLIGHT)
    # The paths are the first thing that is drawn.
    setpoint = draw_flight(recipe, FLIGHT.seconds, np.random.default_rng(5))
    every = truth.drive[::10]
    for i, name in enumerate(AXES):
        drive = drive_of(recipe.axis(name))
        assert setpoint[i, 0] == pytest.approx(position_of(recipe.axis(name).park, drive))
        error = every[:, i] - setpoint[i, : len(every)]
        assert np.sqrt(np.mean(error**2)) < 0.03 * (drive.high - drive.low), name
        assert np.ptp(setpoint[i]) > 0.2 * (drive.high - drive.low), name
        given = truth.command[::10, i]
        valve = recipe.axis(name).valve
        assert not np.any((given > 0.0) & (given < 0.85 * valve.deadband_positive)), name
        assert np.any(given < 0.0)


def test_flight_command() -> None:
    assert flight_command(0.1, 0.1, 0.1, 0.01, 0.05, 0.1, 0.2) == 0.0
    assert flight_command(0.1, 0.1, 0.1001, 0.01, 0.05, 0.1, 0.2) == pytest.approx(0.2 + 0.09, abs=1e-3)
    assert flight_command(0.2, 0.1, 0.1, 0.01, 0.05, 0.1, 0.2) == -1.0


@pytest.mark.parametrize("key", ["pitch", "ripple_frequency", "fade_time"])
def test_irregularity_that_cannot_be_is_refused(tmp_path: Path, key: str) -> None:
    text = (Path(__file__).parents[2] / "datasets" / "autolog" / "bench.toml").read_text("utf-8")
    path = tmp_path / "bench.toml"
    path.write_text(text.replace("[axes.boom]\n", f"[axes.boom]\nirregular = {{{key} = 0.0}}\n"), "utf-8")
    with pytest.raises(SettingsError, match=rf"axes\.boom\.irregular\.{key}: 0\.0; expected more than zero"):
        load_recipe(path)


def test_gear_out_of_true_and_cogging_motor() -> None:
    take = Take("one", 1, 20.0)
    axes = (ServoAxis("shoulder", (-0.5, 1.5), 0.3, 1.0), ServoAxis("elbow", (-2.0, 0.5), 0.25, 0.6))
    arm = ServoArm("servo_arm", "arm", 4, axes, (take,))
    true = run_servo_arm(arm, take)[2]
    wobbling = run_servo_arm(replace(arm, axes=(replace(axes[0], eccentricity=0.003), axes[1])), take)[2]
    assert (wobbling - true)[:, 0] == pytest.approx(0.003 * np.sin(12.0 * true[:, 0]), abs=1e-12)
    slide = Slide("slide", "slide", 5, mass=95.0, recordings=(take,), viscous=200.0)
    cogging = replace(slide, cogging=15.0, pitch=0.04)
    _, force, position = run_slide(cogging, take)
    velocity = np.gradient(position, 1e-3)
    left = force - 95.0 * np.gradient(velocity, 1e-3) - 200.0 * velocity
    wave = np.sin(2.0 * np.pi * position / 0.04)
    smooth = np.abs(np.gradient(np.gradient(velocity, 1e-3), 1e-3)) < 50.0
    assert np.dot(left[smooth], wave[smooth]) / np.dot(wave[smooth], wave[smooth]) == pytest.approx(15.0, rel=0.05)
