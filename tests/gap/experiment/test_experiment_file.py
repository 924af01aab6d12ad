"""An experiment is written and read without loss, and changed files are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_data import arm, nominal, slide
from weak_excitation import slow_dataset

from sysid.errors import SettingsError
from sysid.gap import find_gap
from sysid.gap.experiment import EffectAt, Experiment, Purpose, outside, read_experiment, write_experiment
from sysid.gap.stored_result import load_gap, save_gap

TIE = Purpose(
    "tie",
    'input_delay on boom and "first_order_lag" on boom: expected log-likelihood ratio 31 nats, 20 required.',
    (EffectAt("input_delay", "boom"), EffectAt("first_order_lag", "boom")),
    31.25,
    20.0,
)


def made(boom: list[float], name: str = "boom-steps") -> Experiment:
    time = np.arange(len(boom)) / 100.0
    commands = pd.DataFrame({"time": time, "slew.command": 0.0, "boom.command": boom, "wrist.command": 0.1})
    return Experiment(
        name=name,
        machine="arm",
        motion="steps",
        about="sharp starts and stops of boom",
        axes=("boom",),
        rate_hz=100.0,
        repeats=2,
        start={"boom.cylinder": 0.06, "slew.joint": -1e-7},
        limits={"boom.command": (-1.0, 1.0), "boom.cylinder": (0.006, 0.114)},
        predicted={"boom.cylinder": (0.05, 0.07)},
        purposes=(TIE, replace(TIE, kind="excitation", nats=3.0)),
        provenance={"dataset": "arm@3", "seed": 7},
        commands=commands,
    )


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=50))
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, boom: list[float]) -> None:
    folder = tmp_path_factory.mktemp("experiment")
    experiment = made(boom)
    path = write_experiment(folder, experiment)
    again = read_experiment(path, arm())
    assert again == experiment
    pd.testing.assert_frame_equal(again.commands, experiment.commands, rtol=1e-8, atol=1e-12)
    assert write_experiment(folder, again).read_text() == path.read_text(), "written again it is the same"
    assert sorted(p.name for p in folder.iterdir()) == ["boom-steps.csv", "boom-steps.toml"]


def changed(folder: Path, old: str, new: str) -> Path:
    path = write_experiment(folder, made([0.0, 0.5, -0.5, 0.0]))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("schema = 1", "schema = 2", "schema = 2"),
        ("repeats = 2", "repeat = 2", "did you mean|repeats"),
        ('"boom-steps.csv"', '"../boom-steps.csv"', "leaves the folder"),
        ('"boom-steps.csv"', '"other.csv"', "no such file 'other.csv'"),
        ('"boom.command" = [-1.0, 1.0]', '"boom.command" = [-0.4, 0.4]', "leaves its limits.*Do not execute this file"),
        ("rate_hz = 100.0", "rate_hz = 50.0", "is not k / rate_hz"),
        ("seconds = 0.04", "seconds = 4.0", "0.04 s long; expected 4 s"),
        ('machine = "arm"', 'machine = "segment"', "'segment'; expected 'arm'"),
        ('axes = ["boom"]', 'axes = ["bom"]', "unknown axis 'bom'; expected 'boom'"),
    ],
)
def test_a_changed_file_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        read_experiment(changed(tmp_path, old, new), arm())


def test_commands_belong_to_their_file(tmp_path: Path) -> None:
    path = write_experiment(tmp_path, made([0.0, 0.5]))
    (tmp_path / "boom-steps.csv").write_text((tmp_path / "boom-steps.csv").read_text().replace("0.5", "0.6"))
    with pytest.raises(SettingsError, match="its sha256 is not the one in the TOML file"):
        read_experiment(path)


def test_commands_of_another_machine(tmp_path: Path) -> None:
    path = write_experiment(tmp_path, replace(made([0.0, 0.5]), machine="slide"))
    with pytest.raises(SettingsError, match=r"unknown column 'slew.command'; expected 'slide.command'\? "):
        read_experiment(path, slide())


def test_not_finite(tmp_path: Path) -> None:
    path = write_experiment(tmp_path, made([0.0, np.nan]))
    with pytest.raises(SettingsError, match="a value is not finite"):
        read_experiment(path)


def test_outside_says_which_signals_leave_their_limits() -> None:
    table = pd.DataFrame({"a": [0.0, np.nan, 2.0], "b": [0.0, 0.0, 0.0], "c": [np.nan] * 3})
    assert outside(table, {"a": (0.0, 1.0), "b": (0.0, 0.0), "c": (0.0, 1.0), "not there": (0.0, 1.0)}) == ["a"]


def test_kept_beside_the_result(tmp_path: Path) -> None:
    plant = nominal()
    result = find_gap(slow_dataset(plant, 6.0), plant)
    first = replace(result, experiments=(made([0.0, 0.5]),))
    folder = tmp_path / "gap"
    save_gap(folder, first)
    assert load_gap(folder).experiments == first.experiments  # type: ignore[union-attr]
    (entry,) = first.to_json(folder)["experiments"]
    assert Path(entry["file"]).is_file()
    assert first.to_json()["experiments"][0]["file"] == "experiments/boom-steps.toml"
    save_gap(folder, replace(result, experiments=(made([0.0], "boom-rest"),)))
    left = sorted(p.name for p in (folder / "experiments").iterdir())
    assert left == ["boom-rest.csv", "boom-rest.toml"], "experiments of the previous result are removed"
