"""A machine that differs from its drawing: links, zeros, stance, sensors; and programs that excite one thing at a time."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from simulated_bench import AXES, BenchRecipe, RecordingSettings, Run, load_recipe, simulate
from simulated_bench.capture import frame_rotation, turn_about
from simulated_bench.crane import tip_position
from simulated_bench.cylinder import drive_of
from simulated_bench.machine import run_machine
from simulated_bench.recipe import (
    BuildSettings,
    GripperSettings,
    SensorSettings,
    SlewSensorSettings,
    StrokeSettings,
    WireSettings,
)
from simulated_bench.recipe_file import check_recipe
from sysid.errors import SettingsError

Array = npt.NDArray[np.float64]
PROGRAMS = ("reversals", "stairs", "steps", "together", "rest")


def quiet(recipe: BenchRecipe) -> BenchRecipe:
    capture = replace(recipe.capture, noise=0.0, dropouts_per_minute=0.0, swaps=(), exported_markers=())
    return replace(
        recipe, capture=capture, draw_wire=WireSettings(), slew_sensor=SlewSensorSettings(), gripper=GripperSettings()
    )


def seen_tip(run: Run) -> Array:
    """The tip body's pivot in the surveyed base frame (n, 3)."""
    settings = run.recipe.capture
    body = next(each for each in run.capture.bodies if each.name == "tip_body")
    return np.asarray(body.position @ frame_rotation(settings.rpy).T + np.array(settings.translation))


def test_rotation_vector_is_rodrigues() -> None:
    vector = (0.2, -0.5, 0.9)
    assert turn_about(vector) == pytest.approx(Rotation.from_rotvec(vector).as_matrix(), abs=1e-12)
    assert (turn_about((0.0, 0.0, 0.0)) == np.eye(3)).all()


def test_tip_is_where_the_built_machine_carries_it(recipe: BenchRecipe) -> None:
    """Sensors and reference keep their zeros; the tip knows better. The stance moves what the cameras see."""
    build = BuildSettings(boom=0.002, stick=-0.0015, joint_offset={"boom": math.radians(0.6), "slew": math.radians(-0.4)})
    off = replace(quiet(recipe), build=build)
    off = replace(off, capture=replace(off.capture, shift=(0.004, -0.003, 0.002), tilt=(0.005, -0.004, 0.0)))
    recording = replace(recipe.recording("manual-04"), seconds=20.0)
    run, plain = simulate(off, recording), simulate(quiet(recipe), recording)
    assert (run.truth.joint == plain.truth.joint).all(), "no sensor shows it"
    assert (run.log.wires == plain.log.wires).all()
    geometry = recipe.geometry
    zeros = np.array([math.radians(-0.4), math.radians(0.6), 0.0, 0.0])
    true = run.truth.joint[::50] + zeros
    tips = np.array([tip_position(*q, geometry.height, geometry.boom + 0.002, geometry.stick - 0.0015) for q in true])
    assert run.truth.ee[::50] == pytest.approx(tips, abs=1e-12)
    times = run.capture.clock.to_machine(run.capture.time) - recipe.capture.latency
    standing_error = run.truth.at(times, run.truth.ee) @ turn_about((0.005, -0.004, 0.0)).T + [0.004, -0.003, 0.002]
    assert seen_tip(run) == pytest.approx(standing_error, abs=1e-5)
    assert np.abs(seen_tip(run) - seen_tip(plain)).max() > 0.005


def test_sensors_that_are_off(recipe: BenchRecipe) -> None:
    sensors = (SensorSettings("boom.cylinder", bias=0.002, scale=1.01), SensorSettings("slew.joint", bias=-0.01, quantum=0.002))
    recording = replace(recipe.recording("manual-04"), seconds=10.0)
    plain = simulate(quiet(recipe), recording)
    run = simulate(replace(quiet(recipe), sensors=sensors), recording)
    assert run.log.wires[:, 0] == pytest.approx(1.01 * plain.log.wires[:, 0] + 0.002, abs=1e-12)
    assert (run.log.wires[:, 1:] == plain.log.wires[:, 1:]).all()
    assert run.log.slew == pytest.approx(plain.log.slew - 0.01, abs=0.001 + 1e-12)
    assert run.log.slew / 0.002 == pytest.approx(np.round(run.log.slew / 0.002), abs=1e-9)


def test_wire_that_runs_aside_reads_less(recipe: BenchRecipe) -> None:
    recording = replace(recipe.recording("manual-04"), seconds=10.0)
    plain = simulate(quiet(recipe), recording).log.wires[:, 0]
    oblique = replace(quiet(recipe), sensors=(SensorSettings("boom.cylinder", aside=0.04, standoff=0.16),))
    seen = simulate(oblique, recording).log.wires[:, 0]
    start, length = math.hypot(0.16, 0.04), np.sqrt((0.16 + plain) ** 2 + 0.04**2)
    assert seen == pytest.approx(length - start, abs=1e-12)
    assert np.ptp(seen) < 0.99 * np.ptp(plain)


def test_slew_sensor_on_the_drive_does_not_see_the_play(recipe: BenchRecipe) -> None:
    recording = replace(recipe.recording("manual-04"), seconds=10.0)
    on_drive = simulate(replace(quiet(recipe), slew_sensor=SlewSensorSettings(mount="drive")), recording)
    assert on_drive.log.slew == pytest.approx(on_drive.truth.drive[::10, 0], abs=1e-12)
    on_structure = simulate(quiet(recipe), recording)
    lost = np.ptp(on_drive.log.slew - on_structure.log.slew)
    assert lost == pytest.approx(recipe.axis("slew").backlash, rel=1e-3)


@pytest.mark.parametrize("program", PROGRAMS)
def test_program_stays_inside_the_stops_and_repeats(recipe: BenchRecipe, program: str) -> None:
    recording = RecordingSettings("excite", seed=3, seconds=120.0, program=program)  # type: ignore[arg-type]
    truth = run_machine(recipe, recording, np.random.default_rng(3))
    again = run_machine(recipe, recording, np.random.default_rng(3))
    assert (truth.drive == again.drive).all()
    parked = truth.time < recipe.operator.parked
    assert not truth.command[parked].any()
    for column, name in enumerate(AXES):
        drive = drive_of(recipe.axis(name))
        assert drive.low < truth.drive[:, column].min() <= truth.drive[:, column].max() < drive.high
    moving = (truth.command[::10] != 0.0).sum(axis=1)
    if program == "together":
        assert np.mean(moving == 4) > 0.2
    elif program == "rest":
        assert np.mean(moving == 0) > 0.8
        assert np.ptp(truth.drive[:, 1]) > 0.01
    else:
        assert moving.max() == 1, "axes take turns"
        assert all(np.count_nonzero(np.diff(np.sign(truth.command[::10, k]))) > 10 for k in range(4))
    if program == "stairs":
        assert np.abs(truth.command).max() < 0.4
        assert len(np.unique(np.abs(truth.command))) >= 9


def test_script_is_carried_out(recipe: BenchRecipe, tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "datasets" / "autolog" / "bench.toml").read_text("utf-8")
    path = tmp_path / "bench.toml"
    path.write_text(
        text + '\n[[recordings]]\nname = "mine"\nseed = 9\nseconds = 6.0\nprogram = "script"\n'
        'strokes = [{axis = "stick", start = 1.0, duration = 1.0, level = 0.5}, {axis = "stick", start = 3.0, duration = 1.0, '
        "level = -0.5}]\n",
        "utf-8",
    )
    read = load_recipe(path)
    truth = run_machine(read, read.recording("mine"), np.random.default_rng(0))
    at = np.searchsorted(truth.time, [0.9, 1.5, 2.5, 3.5, 4.5])
    assert truth.command[at, 2] == pytest.approx([0.0, 0.5, 0.0, -0.5, 0.0])
    assert not truth.command[:, [0, 1, 3]].any()


def test_offset_of_no_axis_is_refused(recipe: BenchRecipe) -> None:
    wrong = replace(recipe, build=BuildSettings(joint_offset={"bom": 0.1}))
    with pytest.raises(SettingsError, match=r"build\.joint_offset: unknown axis 'bom'; expected 'boom'"):
        check_recipe(wrong, "bench.toml")


@pytest.mark.parametrize(
    "recording",
    [
        RecordingSettings("s", 1, 5.0, program="script"),
        RecordingSettings("s", 1, 5.0, strokes=(StrokeSettings("boom", 1.0, 1.0, 0.5),)),
        RecordingSettings(
            "s",
            1,
            5.0,
            program="script",
            strokes=(StrokeSettings("boom", 1.0, 1.0, 0.5), StrokeSettings("boom", 1.5, 1.0, 0.5)),
        ),
    ],
)
def test_script_that_cannot_be_carried_out_is_refused(recipe: BenchRecipe, recording: RecordingSettings) -> None:
    with pytest.raises(SettingsError, match="recording 's': stroke"):
        check_recipe(replace(recipe, recordings=(*recipe.recordings, recording)), "bench.toml")
