"""The whole machine: it is deterministic, stays inside its limits, and each feature can be switched off."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import numpy.typing as npt
import pytest

from simulated_bench import AXES, BenchRecipe, RecordingSettings, Run, describe_effects, simulate, without_hidden
from simulated_bench.compiled import cache_folder, compiled
from simulated_bench.cylinder import drive_of, position_of
from simulated_bench.recipe import (
    ControllerSettings,
    GripperSettings,
    HiddenSettings,
    SlewSensorSettings,
    ValveSettings,
    WireSettings,
)
from sysid.errors import SettingsError

Array = npt.NDArray[np.float64]


def neutral(recipe: BenchRecipe) -> BenchRecipe:
    """The crane with ideal valves, drives, sensors: speed = gain · command."""
    axes = {name: replace(axis, backlash=0.0, valve=ValveSettings(gain=axis.valve.gain)) for name, axis in recipe.axes.items()}
    capture = replace(recipe.capture, noise=0.0, offset=(0.0, 0.0), skew=0.0, latency=0.0, dropouts_per_minute=0.0)
    return replace(
        recipe,
        axes=axes,
        gripper=GripperSettings(),
        draw_wire=WireSettings(),
        slew_sensor=SlewSensorSettings(),
        controller=ControllerSettings(),
        capture=capture,
        hidden=(),
    )


def test_neutral_machine_integrates_its_commands(recipe: BenchRecipe) -> None:
    plain = neutral(recipe)
    run = simulate(plain, "manual-01")
    gains = np.array([plain.axis(name).valve.gain for name in AXES])
    travelled = np.cumsum(run.truth.command[:-1], axis=0) * gains * plain.step
    assert run.truth.drive[1:] - run.truth.drive[0] == pytest.approx(travelled, abs=1e-9)
    assert (run.truth.tool == run.truth.ee).all()
    assert run.truth.joint[:, 0] == pytest.approx(run.truth.drive[:, 0], abs=1e-12)
    assert run.log.wires[:, 2] == pytest.approx(run.truth.joint[::10, 3], abs=1e-12)
    assert run.log.slew == pytest.approx(run.truth.joint[::10, 0], abs=1e-12)
    assert (run.log.logged == run.log.stamps[:, None]).all()
    assert describe_effects(plain) == []


def test_same_seed_same_run_other_seed_other_run(recipe: BenchRecipe, manual: Run) -> None:
    again = simulate(recipe, "manual-01")
    assert (again.truth.drive == manual.truth.drive).all()
    assert (again.log.wires == manual.log.wires).all()
    assert np.array_equal(again.capture.bodies[0].position, manual.capture.bodies[0].position, equal_nan=True)
    other = simulate(replace(recipe, seed=recipe.seed + 1), "manual-01")
    assert not np.array_equal(other.truth.command, manual.truth.command)


def test_switching_a_sensor_leaves_the_motion_alone(recipe: BenchRecipe, manual: Run) -> None:
    quiet = simulate(replace(recipe, draw_wire=WireSettings(), capture=replace(recipe.capture, noise=0.0)), "manual-01")
    assert (quiet.truth.joint == manual.truth.joint).all()


@pytest.mark.parametrize("name", [f"manual-0{k}" for k in range(1, 7)])
def test_operator_works_inside_the_end_stops_and_excites_the_machine(recipe: BenchRecipe, name: str) -> None:
    truth = simulate(recipe, name).truth
    assert np.abs(truth.command).max() <= 1.0
    for column, axis in enumerate(AXES):
        drive = drive_of(recipe.axis(axis))
        travel = truth.drive[:, column]
        assert drive.low < travel.min()
        assert travel.max() < drive.high
        assert np.ptp(travel) > (0.1 if axis == "slew" else 0.35) * (drive.high - drive.low)
    parked = truth.time < recipe.operator.parked
    assert not truth.command[parked].any()
    assert truth.joint[0] == pytest.approx([recipe.axis(axis).park for axis in AXES], abs=1e-12)
    assert np.ptp(truth.joint[parked], axis=0) == pytest.approx(0.0, abs=1e-12)
    hanging = truth.tool - truth.ee
    assert hanging[0] == pytest.approx([0.0, 0.0, -recipe.gripper.length], abs=1e-12)
    assert np.abs(hanging[:, :2]).max() > 0.03, "the gripper swings visibly"
    slewing = np.sign(truth.command[::10, 0])
    slewing = slewing[slewing != 0.0]
    assert np.count_nonzero(np.diff(slewing)) >= 12
    moving = (truth.command[::10] != 0.0).sum(axis=1)
    assert np.mean(moving >= 2) > 0.2, "several axes at once"
    assert np.mean(moving == 0) > 0.1, "rests"


def test_structure_follows_the_slewing_drive_with_the_play(recipe: BenchRecipe, manual: Run) -> None:
    lost = manual.truth.drive[:, 0] - manual.truth.joint[:, 0]
    assert np.ptp(lost) == pytest.approx(recipe.axis("slew").backlash, rel=1e-6)


def test_logged_commands_explain_the_motion_on_the_coarse_grid(recipe: BenchRecipe) -> None:
    """A second integration at the controller's rate, from commands alone, ends where the 1 kHz loop does."""
    plain = without_hidden(recipe)
    run = simulate(plain, "manual-02")
    for column, name in enumerate(AXES):
        valve = plain.axis(name).valve
        predicted = coarse_drive(run.truth.command[::10, column], 0.01, valve)
        measured = run.truth.drive[::10, column]
        scale = valve.gain * 60.0
        assert np.abs(predicted - (measured - measured[0])).max() < 5e-5 * scale


def coarse_drive(command: Array, cycle: float, valve: ValveSettings) -> Array:
    """Displacement from held commands with the lag solved in closed form; the delay splits every cycle in two."""
    flow = np.maximum(command - valve.deadband_positive, 0.0) + np.minimum(command + valve.deadband_negative, 0.0)
    time_constant = valve.time_constant
    whole = int(valve.delay // cycle)
    rest = valve.delay - whole * cycle
    out, spool, travelled = np.zeros(len(command)), 0.0, 0.0
    for k in range(len(command) - 1):
        for lag, part in ((whole + 1, rest), (whole, cycle - rest)):
            target = flow[k - lag] if k >= lag else 0.0
            decay = math.exp(-part / time_constant)
            travelled += target * part + (spool - target) * time_constant * (1.0 - decay)
            spool = target + (spool - target) * decay
        out[k + 1] = valve.gain * travelled
    return out


def test_without_hidden_leaves_only_what_the_description_knows(recipe: BenchRecipe) -> None:
    full = {(effect["name"], effect["target"]): effect["hidden"] for effect in describe_effects(recipe)}
    plain = {(effect["name"], effect["target"]) for effect in describe_effects(without_hidden(recipe))}
    assert {key for key, hidden in full.items() if hidden} == {
        ("valve_deadband", "boom"),
        ("backlash", "slew"),
        ("gripper_sway", "tool"),
    }
    assert plain == {key for key, hidden in full.items() if not hidden}


def test_hidden_effect_that_the_machine_does_not_have_is_an_error(recipe: BenchRecipe) -> None:
    wrong = replace(recipe, hidden=(HiddenSettings("valve_deadbnd", "boom"),))
    with pytest.raises(SettingsError, match="no such effect; expected 'valve_deadband'"):
        without_hidden(wrong)


def test_disturbed_flow_changes_the_motion_but_not_the_commands_of_the_routine(recipe: BenchRecipe) -> None:
    boom = recipe.axis("boom")
    rough = replace(recipe, axes={**recipe.axes, "boom": replace(boom, valve=replace(boom.valve, disturbance=0.05))})
    smooth = simulate(recipe, "manual-03").truth
    shaken = simulate(rough, "manual-03").truth
    spread = np.abs(shaken.drive[:, 1] - smooth.drive[:, 1]).max()
    assert 1e-5 < spread < 0.02
    assert (shaken.drive[:, 3] == smooth.drive[:, 3]).all()


def test_routine_takes_still_poses_over_the_whole_range(recipe: BenchRecipe) -> None:
    run = simulate(recipe, RecordingSettings("poses", seed=7, poses=300))
    truth = run.truth
    assert truth.still.shape == (300, 2)
    assert truth.still[:, 1] - truth.still[:, 0] == pytest.approx(recipe.routine.hold, abs=1e-9)
    starts, ends = (np.searchsorted(truth.time, times) for times in truth.still.T)
    assert np.abs(truth.drive[ends] - truth.drive[starts]).max() < 1e-6
    for column, name in enumerate(AXES):
        low, high = recipe.axis(name).limits
        share = (truth.joint[starts, column] - low) / (high - low)
        assert share.min() >= 0.0
        assert share.max() <= 1.0
        # Uniform: Kolmogorov's distance stays below its 0.1 % point.
        distance = np.abs(np.sort(share) - np.linspace(0.0, 1.0, 300)).max()
        assert distance < 1.95 / math.sqrt(300) + recipe.routine.inset


def test_routine_gets_past_a_wide_overlap(recipe: BenchRecipe) -> None:
    telescope = recipe.axes["telescope"]
    valve = replace(telescope.valve, deadband_positive=0.4, deadband_negative=0.35)
    wide = replace(recipe, axes={**recipe.axes, "telescope": replace(telescope, valve=valve)})
    assert len(simulate(wide, RecordingSettings("poses", seed=7, poses=20)).truth.still) == 20


def test_routine_logs_only_still_phases(recipe: BenchRecipe, routine: Run) -> None:
    times = (routine.log.stamps - routine.start_ns) / 1e9
    inside = [(times >= start) & (times <= end) for start, end in routine.truth.still]
    assert np.sum(inside) == len(times)
    assert all(np.count_nonzero(phase) >= 5 for phase in inside)
    assert not routine.log.command.any()


def test_drive_positions_of_the_parked_machine(recipe: BenchRecipe, manual: Run) -> None:
    for column, name in enumerate(AXES):
        axis = recipe.axis(name)
        parked = position_of(axis.park, drive_of(axis))
        assert abs(manual.truth.drive[0, column] - parked) <= 0.5 * axis.backlash + 1e-12


def test_compiled_code_is_kept_apart_by_its_sources(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The folder is named by the sources, other packages keep theirs, and where nothing can be written nothing is kept."""
    before = numba.config.CACHE_DIR
    compiled(lambda x: x)
    assert before == numba.config.CACHE_DIR
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cache_folder.cache_clear()
    try:
        folder = cache_folder()
        assert folder is not None
        assert folder.is_relative_to(tmp_path)
        (tmp_path / "file").write_text("", "utf-8")
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
        cache_folder.cache_clear()
        assert cache_folder() is None
    finally:
        cache_folder.cache_clear()
