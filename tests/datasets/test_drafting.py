"""`sysid start`: what the data show is drafted right, the rest is asked, and the result is what ingest and gap read."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from command_line import run
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lerobot_files import FPS, write_lerobot
from mcap.writer import Writer

from sysid.datasets import Store, ingest
from sysid.datasets.drafting import Description, describe, fields
from sysid.datasets.drafting.fields import Answers
from sysid.datasets.layouts import recording_names
from sysid.datasets.quality.responses import responses_of
from sysid.datasets.recipe import load_recipe
from sysid.errors import InputError, SettingsError, SysidError
from sysid.front.logs import draft
from sysid.logs.csv import CsvReader
from sysid.logs.inspection import inspect_file, inspect_here
from sysid.machine import load_machine

Array = npt.NDArray[np.float64]

#: Names of command and motion for an axis, as loggers write them.
STYLES: dict[str, tuple[Callable[[str, int], str], Callable[[str, int], str]]] = {
    "words": (lambda name, _: f"{name.title()} Cmd", lambda name, _: f"{name.title()} Position"),
    "snake": (lambda name, _: f"cmd_{name}", lambda name, _: f"{name}_meas"),
    "numbers": (lambda _, k: f"goal_pos_{k + 1}", lambda _, k: f"present_pos_{k + 1}"),
    "arrays": (lambda _, k: f"q_des[{k}]", lambda _, k: f"q[{k}]"),
    "camel": (lambda name, _: f"{name}Setpoint", lambda name, _: f"{name}Actual"),
}
NAMES = ("mast", "boom", "stick", "dipper", "grip")  # none says whether it turns


@dataclass(frozen=True)
class Truth:
    """What a generated machine is: by axis the neutral and span of its command, gain, ends of its motion [SI], unit."""

    kind: str
    neutral: Array
    span: Array
    gain: Array
    ends: Array
    unit: str
    rate_hz: float
    count: int


def logs(folder: Path, seed: int) -> Truth:
    """Three logs of a machine of one to five axes, with columns, units, rate and scale of the commands at random."""
    rng = np.random.default_rng(seed)
    kind = ("hydraulic", "servo")[seed % 2]
    count, rate = int(rng.integers(1, 6)), float(rng.choice([20.0, 50.0, 100.0, 200.0]))
    command_name, motion_name = STYLES[str(rng.choice([*STYLES]))]
    unit = str(rng.choice(["mm", "m"] if kind == "hydraulic" else ["rad", "deg"]))
    factor = {"mm": 1e3, "m": 1.0, "rad": 1.0, "deg": 180.0 / np.pi}[unit]
    span = rng.choice([1.0, 100.0, 400.0]) * np.ones(count) if kind == "hydraulic" else np.ones(count)
    neutral = np.where(span == 400.0, 1500.0, 0.0)
    gain = rng.uniform(0.03, 0.2, count)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    folder.mkdir()
    for number in range(3):
        time = np.arange(round(40.0 * rate)) / rate
        columns = {"time": time + 1000.0 * rng.uniform()}
        for k in range(count):
            if kind == "hydraulic":
                pushes = rng.choice([-1.0, -0.6, 0.0, 0.0, 0.6, 1.0], 40)
                pushes = np.where(np.abs(pushes) < 1.0, pushes * rng.uniform(0.7, 1.3, 40), pushes)
                levels = np.repeat(pushes, round(rate))[: len(time)]
                levels[np.repeat(np.arange(40) % 2 == 1, round(rate))[: len(time)]] = 0.0
                late = np.concatenate([np.zeros(round(0.1 * rate)), levels[: len(time) - round(0.1 * rate)]])
                place = 0.4 + np.cumsum(gain[k] * late) / rate
                command = neutral[k] + span[k] * levels
            else:
                command = sum(
                    a * np.sin(2 * np.pi * f * time + p) for a, f, p in rng.uniform([0.2, 0.05, 0], [0.5, 0.4, 6], (3, 3))
                )
                place = np.interp(time - 0.05, time, command)
                command = command * factor
            low[k], high[k] = min(low[k], place.min()), max(high[k], place.max())
            columns[command_name(NAMES[k], k)] = command
            columns[motion_name(NAMES[k], k)] = factor * (place + rng.normal(0.0, 1e-4, len(time)))
        pd.DataFrame(columns).to_csv(folder / f"run{number}.csv", index=False)
    return Truth(kind, neutral, span, gain, np.column_stack([low, high]), unit, rate, count)


def described(folder: Path, given: dict[str, str] | None = None, kind: str | None = None) -> Description:
    files = [inspect_file(path) for path in sorted(folder.glob("*.csv"))]
    return describe(files, folder, "m", Answers(given or {}), kind)


@pytest.mark.parametrize(
    "seed", [30, 11, 44, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(100) if seed not in (11, 30, 44))]
)
def test_what_is_drafted_is_right_or_asked(tmp_path: Path, seed: int) -> None:
    folder = tmp_path / "logs"
    truth = logs(folder, seed)
    found = described(folder)
    asked = {question.key for question in found.questions}
    assert len(asked) <= 5
    for key, text in (("machine.toml", found.machine), ("recipe.toml", found.recipe)):
        (folder / key).write_text(text)
    machine, recipe = load_machine(folder / "machine.toml"), load_recipe(folder / "recipe.toml")
    assert len(machine.axes) == truth.count, found.left_out
    assert machine.rate_hz == truth.rate_hz
    (stream,) = recipe.streams
    for k, axis in enumerate(machine.axes):
        command, motion = stream.signals[f"{axis.name}.command"], stream.signals[axis.driven]
        assert axis.actuation == ("velocity" if truth.kind == "hydraulic" else "position") or "actuation" in asked
        assert motion.unit == truth.unit or asked & {"unit", "angle_unit", "position_unit", "drives"}
        if motion.unit != truth.unit or axis.actuation != "velocity":
            continue
        assert command.zero == pytest.approx(truth.neutral[k], abs=0.01 * truth.span[k])
        assert command.span == pytest.approx(truth.span[k], rel=0.01)
        assert axis.gain == pytest.approx(truth.gain[k], rel=0.02)
        width = truth.ends[k, 1] - truth.ends[k, 0]
        assert axis.range == pytest.approx(tuple(truth.ends[k]), abs=0.01 * width)


def test_an_answer_replaces_the_proposal(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    logs(folder, 24)  # a hydraulic machine with columns in mm
    assert 'unit = "cm"' in described(folder, {"unit": "cm"}).recipe
    with pytest.raises(SettingsError, match="no choice"):
        described(folder, {"unit": "inch"})
    with pytest.raises(SettingsError, match="no such question"):
        described(folder, {"units": "cm"})


def test_a_motion_that_is_computed_from_its_command_is_asked(tmp_path: Path) -> None:
    """An integrated command has no noise and no delay; a simulation of it would be perfect, and mean nothing."""
    folder = tmp_path / "logs"
    logs(folder, 0)
    for path in folder.glob("*.csv"):
        table = pd.read_csv(path)
        command, motion = table.columns[1:3]
        rate = 1.0 / float(np.median(np.diff(table["time"])))
        share = (table[command] - table[command].mode()[0]) / 400.0
        table.assign(**{motion: 300.0 + np.cumsum(share) / rate}).to_csv(path, index=False)
    found = described(folder)
    (question,) = [question for question in found.questions if question.key.endswith(".measured")]
    assert question.proposal == "no"
    kept = described(folder, {question.key: "yes"})
    assert len(kept.axes) == len(found.axes) + 1


def test_columns_that_say_nothing_are_assigned(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    truth = logs(folder, 24)
    for path in folder.glob("*.csv"):
        table = pd.read_csv(path).iloc[:, :3]
        table.set_axis(["time", "vir", "xm"], axis=1).to_csv(path, index=False)
    with pytest.raises(InputError, match=r"--set AXIS\.command=COLUMN --set AXIS\.motion=COLUMN, of vir and xm"):
        described(folder)
    found = described(folder, {"lift.command": "vir", "lift.motion": "xm"})
    assert found.axes == ("lift",)
    assert f"gain = {truth.gain[0]:.2g}"[:10] in found.machine
    with pytest.raises(SettingsError, match="no such column"):
        described(folder, {"lift.command": "virr"})


def test_tables_of_one_recording_are_kept_apart_by_their_files(tmp_path: Path) -> None:
    """``control.csv`` and ``state.csv`` with the same column names: the file says which is the command."""
    folder = tmp_path / "logs"
    logs(tmp_path / "flat", 1)
    for path in (tmp_path / "flat").glob("*.csv"):
        place = folder / path.stem
        place.mkdir(parents=True)
        table = pd.read_csv(path)
        table.iloc[:, [0, 1]].set_axis(["time", "positions[0]"], axis=1).to_csv(place / "control.csv", index=False)
        table.iloc[:, [0, 2]].set_axis(["time", "positions[0]"], axis=1).to_csv(place / "state.csv", index=False)
    files = [inspect_file(path) for path in sorted(folder.glob("*/*.csv"))]
    found = describe(files, folder, "m", Answers({}))
    (folder / "machine.toml").write_text(found.machine)
    (folder / "recipe.toml").write_text(found.recipe)
    streams = {stream.files: [*stream.signals] for stream in load_recipe(folder / "recipe.toml").streams}
    assert streams == {"control.csv": ["axis.command"], "state.csv": ["axis.joint"]}


def test_a_recording_in_another_unit_has_an_entry_of_its_own(tmp_path: Path) -> None:
    """One log in centimetres, the others in millimetres, under the same names."""
    folder = tmp_path / "logs"
    truth = logs(folder, 24)  # a hydraulic machine with columns in mm
    path = folder / "run1.csv"
    table = pd.read_csv(path)
    table.assign(**{name: table[name] / 10.0 for name in table.columns[2::2]}).to_csv(path, index=False)
    found = described(folder, {"drives": "cylinder"})
    assert [(q.key, q.proposal) for q in found.questions if q.key.startswith("unit.")] == [("unit.run1", "cm")]
    (folder / "machine.toml").write_text(found.machine)
    (folder / "recipe.toml").write_text(found.recipe)
    units = {
        stream.files: {m.unit for m in stream.signals.values() if m.unit}
        for stream in load_recipe(folder / "recipe.toml").streams
    }
    assert units["run1.csv"] == {"cm"}
    assert {*units} - {"run1.csv"}
    for k, axis in enumerate(load_machine(folder / "machine.toml").axes):
        assert axis.gain == pytest.approx(truth.gain[k], rel=0.02)


def with_the_motor_off(folder: Path, off: tuple[int, ...], count: int = 6) -> None:
    """Logs of a servo; in those that are ``off`` its arm falls while its setpoint rises."""
    folder.mkdir()
    time = np.arange(600) / 50.0
    for k in range(count):
        goal = np.sin(0.6 * time + k) if k not in off else 0.1 * time
        place = np.interp(time - 0.08, time, goal) if k not in off else -0.7 * (1.0 - np.exp(-0.4 * time))
        pd.DataFrame({"t": time, "goal_position": goal, "position": place}).to_csv(folder / f"run{k}.csv", index=False)


@pytest.fixture
def without_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """``sysid start`` ends before its search, which ``test_a_description_that_is_there_is_used`` makes."""
    monkeypatch.setattr("sysid.cli.gap.gap", lambda **_: None)


@pytest.mark.usefixtures("without_search")
def test_recordings_in_which_the_command_does_not_act_are_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with_the_motor_off(tmp_path / "logs", (1, 4))
    found = described(tmp_path / "logs", {"position_unit": "rad"})
    (question,) = found.questions
    assert (question.key, question.proposal) == ("left_out", "run1,run4")
    assert "goes against" in question.why
    assert '"run1/run1.csv", "run4/run4.csv"' in found.recipe
    kept = described(tmp_path / "logs", {"position_unit": "rad", "left_out": "none"}, "servo")
    assert kept.questions == ()
    assert "left_out" not in kept.recipe
    with pytest.raises(SettingsError, match=r"left_out=run2: 'run2'; expected none, or some of run1,run4"):
        described(tmp_path / "logs", {"left_out": "run2"})
    answers = ["--set", "position_unit=rad", "--set", "left_out=run1,run4"]
    assert run("--workspace", tmp_path / "w", "start", tmp_path / "logs", "--out", tmp_path / "m", *answers) == 0
    shown = capsys.readouterr().out
    assert "left out: run4: position goes against goal_position" in shown
    assert "commands are positions" in shown
    assert "SEVERE" not in shown
    assert "2 files left out by the recipe" in shown.replace("\n", " ")


def test_recordings_that_all_follow_are_not_asked(tmp_path: Path) -> None:
    with_the_motor_off(tmp_path / "logs", ())
    assert [q.key for q in described(tmp_path / "logs").questions] == ["position_unit"]


def test_a_force_may_be_against_its_motion(tmp_path: Path) -> None:
    """Below its resonance a pendulum follows a torque, above it moves against it."""
    time = np.arange(600) / 50.0
    for k, (size, rate) in enumerate(((1.0, 1.0), (0.5, 1.2), (-0.2, 9.0))):
        table = {"t": time, "tau": np.sin(rate * time), "angle": size * np.sin(rate * time)}
        pd.DataFrame(table).to_csv(tmp_path / f"run{k}.csv", index=False)
    for kind in (None, "force"):
        assert "left_out" not in [q.key for q in described(tmp_path, kind=kind).questions]


def test_a_column_that_is_empty_in_a_file_has_no_line_for_it(tmp_path: Path) -> None:
    time, folder = np.arange(300) / 50.0, tmp_path / "logs"
    folder.mkdir()
    for k in range(3):
        table = {"t": time}
        for axis in (1, 2):
            goal = np.sin(axis * time + k)
            table |= {f"goal ({axis})": goal, f"pos ({axis})": np.interp(time - 0.1, time, goal)}
        if k == 1:
            table |= {"goal (2)": np.nan * time, "pos (2)": np.nan * time}
        pd.DataFrame(table).to_csv(folder / f"run{k}.csv", index=False)
    found = described(folder, {"position_unit": "rad"})
    assert "run1: no number in goal (2) and pos (2)" in found.left_out
    (folder / "machine.toml").write_text(found.machine)
    (folder / "recipe.toml").write_text(found.recipe)
    dataset = ingest(folder, tmp_path / "w", recipe=folder / "recipe.toml")
    measured = {r.name: np.isfinite(r.values("axis_2.joint")).any() for r in dataset.recordings}
    assert measured == {"run0": True, "run1": False, "run2": True}


PENDULUM = """<robot name="pendulum">
<link name="bob"><inertial><origin xyz="0 0 -0.5"/><mass value="1"/></inertial></link>
<joint name="swing" type="continuous"><parent link="world"/><child link="bob"/><axis xyz="0 1 0"/></joint></robot>"""


@pytest.mark.parametrize(("column", "actuation"), [("swing_tau", "force"), ("swing_desired", "position")])
def test_what_the_robots_file_does_not_state_is_as_the_data_show(tmp_path: Path, column: str, actuation: str) -> None:
    time = np.arange(600) / 50.0
    given = np.sign(np.sin(time)) + np.sin(2.3 * time)
    table = {"t": time, column: given, "swing_angle": np.interp(time - 0.1, time, given)}
    pd.DataFrame(table).to_csv(tmp_path / "run.csv", index=False)
    (tmp_path / "pendulum.urdf").write_text(PENDULUM)
    drafted = draft(tmp_path, "m", tmp_path / "pendulum.urdf", None, {}, None)
    assert f'actuation = "{actuation}"' in drafted.description.machine
    assert drafted.description.axes == ("swing",)


def test_what_neither_robot_nor_data_state_is_asked(tmp_path: Path) -> None:
    time = np.arange(600) / 50.0
    table = {"t": time, "swing_desired": np.sin(time), "swing_angle": 0.6 * np.sin(time) + 0.5 * np.sin(3.3 * time + 1.0)}
    pd.DataFrame(table).to_csv(tmp_path / "run.csv", index=False)
    (tmp_path / "pendulum.urdf").write_text(PENDULUM)
    with pytest.raises(SettingsError, match="Add --kind servo"):
        draft(tmp_path, "m", tmp_path / "pendulum.urdf", None, {}, None)
    drafted = draft(tmp_path, "m", tmp_path / "pendulum.urdf", None, {"actuation": "force"}, None)
    assert 'actuation = "force"' in drafted.description.machine


def test_a_command_without_effect_in_some_recordings_is_a_cause(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with_the_motor_off(tmp_path / "logs", (1, 4))
    answers = ["--set", "position_unit=rad", "--set", "left_out=none"]
    assert (
        run("--workspace", tmp_path / "w", "start", tmp_path / "logs", "--out", tmp_path / "m", "--kind", "servo", *answers)
        != 0
    )
    shown = " ".join(capsys.readouterr().out.split())
    assert "in run1 and run4 likely cause" in shown
    assert "the command of axis axis is without effect in these recordings: a drive that is off, or in another mode" in shown


@pytest.mark.parametrize(("mass", "note"), [(2.5, "from force and acceleration"), (-1.0, "assumed: these logs do not show it")])
def test_an_inertia_that_the_logs_do_not_show_is_said_to_be_assumed(tmp_path: Path, mass: float, note: str) -> None:
    """A force against the acceleration is no mass."""
    folder = tmp_path / "logs"
    folder.mkdir()
    time = np.arange(4000) / 100.0
    place = sum(np.sin(f * time + f) for f in (1.0, 2.3, 3.7))
    force = mass * sum(-(f**2) * np.sin(f * time + f) for f in (1.0, 2.3, 3.7))
    pd.DataFrame({"time": time, "q_1": place, "tau_1": force}).to_csv(folder / "a.csv", index=False)
    (line,) = [line for line in described(folder, kind="force").machine.splitlines() if line.startswith("inertia = ")]
    assert note in line
    if mass > 0.0:
        assert float(line.split()[2]) == pytest.approx(mass, rel=0.05)


def test_the_scale_of_a_force_without_a_unit_is_asked_and_masses_follow_it(tmp_path: Path) -> None:
    (folder := tmp_path / "logs").mkdir()
    time = np.arange(2000) / 100.0
    place = sum(np.sin(f * time + f) for f in (1.0, 2.3, 3.7))
    volts = 0.5 * sum(-(f**2) * np.sin(f * time + f) for f in (1.0, 2.3, 3.7))
    pd.DataFrame({"time": time, "q_1 [rad]": place, "q_2 [rad]": place, "tau_1": volts, "tau_2": volts}).to_csv(
        folder / "a.csv", index=False
    )
    asked = described(folder, kind="force")
    (question,) = (each for each in asked.questions if "force_scale" in each.key)
    assert (question.key, question.proposal) == ("force_scale", "1")
    found = described(folder, {"force_scale": "4", "axis_2.force_scale": "8"}, kind="force")
    masses = [float(line.split()[2]) for line in found.machine.splitlines() if line.startswith("inertia = ")]
    assert masses == pytest.approx([2.0, 4.0], rel=0.02)
    assert 'field = "tau_1", scale = 4, unit = "N·m" }   # no unit stated' in found.recipe
    with pytest.raises(SettingsError, match="force_scale"):
        described(folder, {"force_scale": "much"}, kind="force")


@pytest.mark.usefixtures("without_search")
def test_tables_without_a_time_have_the_rate_that_is_stated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The remedy of the refusal, followed to the letter, and records in a file whose suffix says nothing."""
    logs(tmp_path / "logs", 35)
    for path in (tmp_path / "logs").glob("*.csv"):
        table = pd.read_csv(path).drop(columns="time")
        path.with_suffix(".json").write_text(table.to_json(orient="records"))
        path.unlink()
    verb = ("--workspace", tmp_path / "ws", "start", tmp_path / "logs")
    assert run(*verb) == 2
    assert "Inspect with --reader json" in capsys.readouterr().err
    assert run(*verb, "--reader", "json") == 2
    assert "--set rate_hz=100" in capsys.readouterr().err
    assert run(*verb, "--reader", "json", "--set", "rate_hz=0") == 2
    assert "--set rate_hz" in capsys.readouterr().err
    assert run(*verb, "--reader", "json", "--set", "rate_hz=50", "--yes", "--out", tmp_path / "m") == 0
    recipe = load_recipe(tmp_path / "m/recipe.toml")
    assert {(stream.reader, stream.rate_hz) for stream in recipe.streams} == {("json", 50.0)}
    assert "rate_hz = 50.0" in (tmp_path / "m/machine.toml").read_text()


def test_columns_without_a_command_are_said(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    logs(folder, 24)
    for path in folder.glob("*.csv"):
        table = pd.read_csv(path)
        table.assign(battery_level=np.linspace(12.0, 11.0, len(table))).to_csv(path, index=False)
    assert any(line.startswith("battery_level: no command beside it") for line in described(folder).left_out)


numbers = st.floats(width=64) | st.sampled_from([0.0, 1.0, 1e300, -1e-300, math.nan, math.inf])
names = st.sampled_from(["boom cmd", "boom pos", "cmd", "pos", "q[0]", "tau_1", "q_1", "valve", "x (mm)", "speed", "JS", "ä"])


@given(st.integers(0, 40), st.lists(names, min_size=1, max_size=5, unique=True), st.data())
@settings(max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_the_columns_hold_there_is_a_description_or_a_reason(
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    rows: int,
    columns: list[str],
    data: st.DataObject,
) -> None:
    folder = tmp_path_factory.mktemp("logs")
    monkeypatch.setattr(fields, "read_confined", lambda reader, path, options: reader.read(path, options))
    table = {name: data.draw(st.lists(numbers, min_size=rows, max_size=rows)) for name in columns}
    pd.DataFrame({"time": np.arange(rows) * 0.5, **table}).to_csv(folder / "a.csv", index=False)
    with contextlib.suppress(SysidError):
        found = describe([inspect_here(folder / "a.csv", CsvReader())], folder, "m", Answers({}))
        (folder / "machine.toml").write_text(found.machine)
        (folder / "recipe.toml").write_text(found.recipe)
        assert load_machine(folder / "machine.toml").axis_names == found.axes
        load_recipe(folder / "recipe.toml")


@pytest.mark.slow
def test_from_a_folder_to_a_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, workspace, result = tmp_path / "digger", tmp_path / "ws", tmp_path / "start.json"
    logs(folder, 24)
    verb = ("--workspace", workspace, "start", folder)
    assert run(*verb) == 2
    assert not (folder / "machine.toml").exists()
    assert run(*verb, "--set", "drives=cylinder", "--yes", "--json", result) == 0
    values = json.loads(result.read_text())
    verdict = json.loads(result.with_suffix(".gap.json").read_text())
    for response in values["responses"]:
        assert response["delay95"][0] <= 0.1 <= response["delay95"][1]
    assert {effect["name"] for effect in verdict["effects"]} == {"input_delay"}
    described = {each["target"] for each in verdict["written"] if each["name"] == "gain_error"}
    assert described, "the gain is only estimated: a better value is not reported as a missing effect"
    capsys.readouterr()
    assert run(*verb) == 0
    assert "kept" in capsys.readouterr().out


def imitation(folder: Path, lags: Sequence[float], noise: float = 0.05, episodes: int = 4, against: int | None = None) -> Path:
    """A LeRobot dataset in two files whose joints follow their actions ``lags`` [s] later; one episode may go against them."""
    made = []
    for number in range(episodes):
        rng, time = np.random.default_rng(number), np.arange(600) / FPS
        columns = []
        for lag in lags:
            size, frequency, phase = rng.uniform(5.0, 25.0, 4), rng.uniform(0.05, 0.9, 4), rng.uniform(0.0, 6.0, 4)
            action, state = (np.sin(2.0 * np.pi * np.outer(t, frequency) + phase) @ size for t in (time, time - lag))
            columns.append((action, (-1.0 if number == against else 1.0) * state + rng.normal(0.0, noise, len(time))))
        made.append((np.column_stack([a for a, _ in columns]), np.column_stack([s for _, s in columns])))
    return write_lerobot(folder, made, [f"{name}.pos" for name in NAMES[: len(lags)]], files=2)


def test_an_imitation_set_becomes_recordings_with_the_delay_of_every_joint(tmp_path: Path) -> None:
    lags = (0.0, 0.02, 0.15, 0.3)
    drafted = draft(imitation(tmp_path / "set", lags), "m", None, None, {"position_unit": "deg"}, None)
    assert drafted.description.axes == NAMES[:4]
    assert not drafted.description.left_out
    drafted.write(tmp_path / "set")
    dataset = ingest(tmp_path / "set", tmp_path / "ws")
    assert sorted(recording.name for recording in dataset.recordings) == [f"episode-00000{k}" for k in range(4)]
    for lag, response in zip(lags, responses_of(dataset), strict=True):
        assert response.delay == pytest.approx(lag, abs=0.002)
        assert response.delay95[0] <= lag <= response.delay95[1]
        assert response.delays90 == pytest.approx((lag, lag), abs=0.003)


def test_an_episode_that_goes_against_the_others_is_left_out_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = imitation(tmp_path / "set", (0.1,), against=1)
    drafted = draft(folder, "m", None, None, {"position_unit": "deg", "left_out": "episode-000001"}, None)
    assert [line.partition(":")[0] for line in drafted.description.left_out] == ["episode-000001"]
    drafted.write(folder)
    assert run("--workspace", tmp_path / "ws", "ingest", folder) == 0
    assert "1 file left out by the recipe: episode-000001/file-000.parquet" in " ".join(capsys.readouterr().out.split())
    dataset = Store(tmp_path / "ws").load("m")
    assert sorted(recording.name for recording in dataset.recordings) == [f"episode-00000{k}" for k in (0, 2, 3)]


def test_a_description_that_is_there_is_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A machine.toml and canonical columns need no recipe; a recipe needs its machine."""
    folder = tmp_path / "logs"
    logs(folder, 214)
    (folder / "recipe.toml").write_text("schema = 1\n")
    assert run("--workspace", tmp_path / "ws", "start", folder, "--yes") == 2
    assert "without machine.toml" in capsys.readouterr().err
    (folder / "recipe.toml").unlink()
    own = tmp_path / "canonical"
    own.mkdir()
    for path in folder.glob("*.csv"):
        (own / path.stem).mkdir()
        table = pd.read_csv(path).iloc[:, :3]
        table.set_axis(["time", "lift.command", "lift.cylinder [mm]"], axis=1).to_csv(own / path.stem / "log.csv", index=False)
    found = described(folder, {"drives": "cylinder"})
    (own / "machine.toml").write_text(found.machine.replace(f'name = "{found.axes[0]}"', 'name = "lift"'))
    assert run("--workspace", tmp_path / "ws", "start", own, "--yes") == 0
    assert f"kept  {own / 'machine.toml'}" in capsys.readouterr().out


def test_recordings_have_the_names_of_their_files(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    logs(folder, 1)
    files = [inspect_file(path) for path in sorted(folder.glob("*.csv"))]
    assert recording_names(files, False, [frozenset()] * 3)[1]


def test_the_axes_of_a_bag_are_paired_by_labels(tmp_path: Path) -> None:
    """Joints of a message are named in brackets; stamps are no columns."""
    rng = np.random.default_rng(0)
    command = np.repeat(rng.uniform(-1, 1, (60, 2)), 20, axis=0)
    late = np.vstack([np.zeros((5, 2)), command])[: len(command)]
    angle = np.cumsum(late, axis=0) / 50.0 + rng.normal(0.0, 1e-3, command.shape)
    names = ["boom_joint", "stick_joint"]
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = [writer.register_channel(topic, "json", 0) for topic in ("/velocity_cmd", "/joint_states")]
        for k in range(len(command)):
            stamp = int(1e9 * (1.7e9 + k / 50.0))
            head = {"header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}}}
            order = [1, 0] if k % 7 == 3 else [0, 1]
            bodies = ({"velocity": command[k, order].tolist()}, {"position": angle[k, order].tolist()})
            for channel, body in zip(channels, bodies, strict=True):
                text = {**head, "name": [names[n] for n in order], **body}
                writer.add_message(channel, stamp, json.dumps(text).encode(), stamp)
        writer.finish()
    found = describe([inspect_file(tmp_path / "log.mcap")], tmp_path, "rig", Answers({}))
    assert found.axes == ("boom", "stick")
    assert '"boom.command" = { topic = "/velocity_cmd", field = "velocity[boom_joint]"' in found.recipe
    assert 'field = "position[stick_joint]"' in found.recipe
    assert not any("stamp" in line for line in found.left_out)


def table(folder: Path, columns: dict[str, Array]) -> Description:
    """What is drafted of one log at 50 Hz with these columns."""
    folder.mkdir()
    time = np.arange(len(next(iter(columns.values())))) / 50.0
    pd.DataFrame({"time": time, **columns}).to_csv(folder / "a.csv", index=False)
    return described(folder)


def followed(count: int, size: float = 1.0) -> list[tuple[Array, Array]]:
    """Setpoints and the places that follow them, for ``count`` axes."""
    time = np.arange(3000) / 50.0
    points = [size * (np.sin(0.7 * time + k) + 0.4 * np.sin((1.9 + 0.3 * k) * time)) for k in range(count)]
    return [(point, np.interp(time - 0.1, time, point)) for point in points]


@pytest.mark.parametrize(
    ("command", "motion", "axes"),
    [
        ("u{}", "y{}", ("axis_1", "axis_2")),
        ("target pos ({})", "pos ({})", ("axis_1", "axis_2")),
        ("Soll_Gelenk{}", "Ist_Gelenk{}", ("axis_1", "axis_2")),
        ("Stellgröße Löffel {}", "Weg Löffel {}", ("axis_1", "axis_2")),
        ("axis {} in", "axis {} out", ("axis_1", "axis_2")),
        ("i_valve_{}", "wire_{}", ("axis_1", "axis_2")),
        ("qd_{}", "q_{}", ("axis_1", "axis_2")),
    ],
)
def test_columns_are_paired_as_people_name_them(tmp_path: Path, command: str, motion: str, axes: tuple[str, ...]) -> None:
    both = followed(2)
    columns = {name.format(k + 1): own[n] for k, own in enumerate(both) for n, name in enumerate((command, motion))}
    found = table(tmp_path / "logs", columns)
    assert len(found.axes) == len(axes), found.left_out
    for k in (1, 2):
        name = next(name for name in found.axes if name.endswith(f"_{k}"))
        assert f'"{name}.command" = {{ field = "{command.format(k)}"' in found.recipe
        assert f'field = "{motion.format(k)}"' in found.recipe


@pytest.mark.parametrize("name", ["base", "tool", "machine", "time"])
def test_an_axis_with_a_reserved_name_is_renamed(tmp_path: Path, name: str) -> None:
    ((setpoint, place),) = followed(1)
    found = table(tmp_path / "logs", {f"cmd_{name}": setpoint, f"pos_{name}": place, "battery": np.linspace(12.0, 11.0, 3000)})
    assert found.axes == (f"axis_{name}",)


@pytest.mark.parametrize(("ending", "unit"), [("_N", "N"), ("_Nm", "N·m"), ("_nm", "N·m"), (" (Nm)", "N·m"), (" [N]", "N")])
def test_the_unit_of_a_force_in_a_name(tmp_path: Path, ending: str, unit: str) -> None:
    time = np.arange(3000) / 50.0
    columns = {f"tau_1{ending}": -2.0 * np.sin(time), "q_1_rad": np.sin(time)}
    assert f'unit = "{unit}"' in table(tmp_path / "logs", columns).recipe


def test_counts_of_an_encoder_are_asked(tmp_path: Path) -> None:
    ((setpoint, place),) = followed(1, 700.0)
    found = table(tmp_path / "logs", {"goal_pos": np.round(2048.0 + setpoint), "present_pos": np.round(2048.0 + place)})
    assert [(q.key, q.proposal) for q in found.questions] == [("position_unit", "4096/turn")]
    assert f'span = {4096.0 / (2.0 * math.pi):.9g}, unit = "rad"' in found.recipe


@pytest.mark.parametrize("rate", [240.0, 400.0, 150.0, 60.0])
def test_the_rate_of_stamps_in_whole_milliseconds(tmp_path: Path, rate: float) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    time = np.arange(5000) / rate
    setpoint = np.sin(time) + 0.4 * np.sin(2.3 * time)
    columns = {"time_ms": np.round(1e3 * time).astype(int), "cmd_1": setpoint, "pos_1": np.interp(time - 0.1, time, setpoint)}
    pd.DataFrame(columns).to_csv(folder / "a.csv", index=False)
    assert f"rate_hz = {rate} " in described(folder).machine


def test_one_answer_for_all_axes_and_one_for_a_single_axis(tmp_path: Path) -> None:
    both = followed(2, 40.0)
    columns = {name: own[n] for k, own in enumerate(both) for n, name in enumerate((f"goal_{k + 1}", f"present_{k + 1}"))}
    assert [q.key for q in table(tmp_path / "logs", columns).questions] == ["position_unit"]
    found = described(tmp_path / "logs", {"position_unit": "deg", "axis_2.unit": "mm"})
    assert not found.questions
    assert 'field = "present_1", unit = "deg"' in found.recipe
    assert 'field = "present_2", unit = "mm"' in found.recipe
