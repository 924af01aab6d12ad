"""When a network pays: what models learn from, what they may read of a test recording, and the page of the figures."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from sysid.datasets import Recording
from sysid.machine import load_machine

Array = npt.NDArray[np.float64]
RATE = 50.0


@pytest.fixture(scope="module")
def pays(pipeline: Callable[[str], ModuleType]) -> ModuleType:
    return pipeline("network_pays")


@pytest.fixture(scope="module")
def machines(pays: ModuleType) -> ModuleType:
    return sys.modules["pays.machines"]


@pytest.fixture(scope="module")
def models(pays: ModuleType) -> ModuleType:
    return sys.modules["pays.models"]


def recording(name: str, seconds: float, gap: tuple[float, float] | None = None) -> Recording:
    """The bucket of the excavator at half its gain, driven by a sine."""
    time = np.arange(round(seconds * RATE)) / RATE
    command = np.sin(2.0 * np.pi * time / 3.0)
    table = pd.DataFrame(
        {"time": time, "bucket.command": command, "bucket.cylinder": 0.06 + 0.007 * (1.0 - np.cos(2.1 * time))}
    )
    if gap is not None:
        table.loc[(time >= gap[0]) & (time < gap[1]), "bucket.command"] = np.nan
    return Recording(name, table, RATE)


@pytest.fixture
def source(machines: ModuleType, datasets_folder: Path) -> Any:
    machine = load_machine(datasets_folder / "rc_excavator/machine.toml")
    training = [recording("a", 20.0), recording("b", 10.0)]
    signals = ["bucket.command", "bucket.cylinder"]
    return machines.source("bucket", machine, "bucket", training, [recording("test", 12.0)], signals, (5.0, 25.0, np.inf), "m")


def test_lengths_end_with_all_there_is(source: Any) -> None:
    assert source.lengths == (5.0, 25.0, 30.0)


def test_the_leading_part_is_cut_and_every_recording_has_both_roles(
    machines: ModuleType, models: ModuleType, source: Any
) -> None:
    data = machines.in_blocks(source.machine, machines.leading(source.training, 25.0), models.BLOCKS)
    assert {name: (role, len(data.recording(name))) for name, role in data.splits.items()} == {
        "a fit": ("fit", 700),
        "a select": ("select", 300),
        "b fit": ("fit", 175),
        "b select": ("select", 75),
    }
    first, second = (data.recording(f"a {role}").values("bucket.command") for role in ("fit", "select"))
    np.testing.assert_array_equal(np.concatenate([first, second]), source.training[0].values("bucket.command"))


def test_starts_and_ends_of_stretches_are_not_evaluated(machines: ModuleType) -> None:
    rows = machines.evaluated_rows(recording("test", 12.0, gap=(5.0, 6.0)), "bucket.command", "bucket.cylinder")
    warm, tail = round(machines.WARM_UP * RATE), round(machines.TAIL * RATE)
    expected = np.zeros(600, dtype=bool)
    expected[warm : 250 - tail] = expected[300 + warm : 600 - tail] = True
    np.testing.assert_array_equal(rows, expected)


def test_pieces_are_evaluated_on_rows_of_their_own(machines: ModuleType) -> None:
    whole = recording("test", 12.0)
    cut = machines.pieces([whole])
    rows = [machines.evaluated_rows(piece, "bucket.command", "bucket.cylinder") for piece in cut]
    assert [int(each.sum()) for each in rows] == [round(machines.PIECE * RATE)] * 5
    joined = np.concatenate([piece.values("bucket.cylinder")[each] for piece, each in zip(cut, rows, strict=True)])
    np.testing.assert_array_equal(joined, whole.values("bucket.cylinder")[50:550])


def constant(models: ModuleType, output: float) -> Any:
    """A recurrent network whose output does not depend on its input."""
    cell = {"mean": np.zeros(1), "scale": np.ones(1), "W": np.zeros((8, 1)), "U": np.zeros((8, 2)), "b": np.zeros(8)}
    weights = {**cell, "w": np.zeros(2), "w0": np.array([np.arctanh(output)])}
    return models.RecurrentNetwork("bucket.command", "bucket.cylinder", False, weights, 1.0, (0.0, 0.1))


def test_a_recurrent_network_integrates_its_speed_from_the_end_of_the_warm_up(machines: ModuleType, models: ModuleType) -> None:
    test = recording("test", 12.0)
    run, start = constant(models, 0.002).free_run(test), round(machines.WARM_UP * RATE)
    begin = test.values("bucket.cylinder")[start]
    assert np.isnan(run[:start]).all()
    np.testing.assert_allclose(run[start:590], begin + 0.002 * np.arange(590 - start) / RATE, atol=1e-12)
    assert constant(models, 0.1).free_run(test)[590] == 0.1, "the end stop"


def test_no_network_reads_the_measurement_behind_the_warm_up_or_a_later_command(
    machines: ModuleType, models: ModuleType, source: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(models, "RECURRENT", replace(models.RECURRENT, epochs=2, check_every=1))
    data = machines.in_blocks(source.machine, source.training, models.BLOCKS)
    recipe = models.parse_recipe({"motion": {"members": 1, "training": {"epochs": 2}}}, "test")
    networks = [
        models.started(models.fit_motion(data, recipe)["bucket"]),
        models.fit_recurrent(source, data, 0).free_run,
    ]
    (test,) = source.test
    other, later = test.table.copy(), test.table.copy()
    other.loc[other.index[60:], "bucket.cylinder"] = 0.0
    later.loc[later.index[300:], "bucket.command"] = 1.0
    for predict in networks:
        run = predict(test)
        assert np.isfinite(run[50:590]).all()
        np.testing.assert_array_equal(predict(replace(test, table=other)), run)
        changed = predict(replace(test, table=later))
        np.testing.assert_array_equal(changed[:298], run[:298])
        assert (changed[310:590] != run[310:590]).any()


def test_a_network_pays_from_the_length_on_at_which_every_seed_stays_better(pays: ModuleType) -> None:
    page = sys.modules["pays.page"]

    def entry(seconds: float, found: float | None, seeds: tuple[float, ...]) -> dict[str, Any]:
        plant = None if found is None else {"whole": found}
        networks = [{"whole": value} for value in seeds]
        described = {"whole": 10.0}
        return {"seconds": seconds, page.DESCRIBED: described, page.FOUND: plant, page.MOTION_NETWORK: networks}

    lengths = [
        entry(5.0, None, (8.0, 9.0)),
        entry(10.0, 2.0, (1.0, 3.0)),
        entry(20.0, 2.0, (1.0, 1.5)),
        entry(40.0, 2.0, (0.5, 1.0)),
    ]
    assert page.pays_from({"lengths": lengths}, page.MOTION_NETWORK, "whole") == 20.0
    assert page.pays_from({"lengths": lengths[:1]}, page.MOTION_NETWORK, "whole") is None, "no plant with effects"
    assert page.pays_from({"lengths": [*lengths, entry(80.0, 2.0, ())]}, page.MOTION_NETWORK, "whole") is None


def test_what_the_folder_has_is_not_run_again_and_a_set_that_is_not_there_keeps_its_figures(
    pays: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = list[int]()

    def make() -> dict[str, Any]:
        runs.append(1)
        return {"error": 1.0}

    (tmp_path / "cases").mkdir()
    first, second = (pays.kept(tmp_path, "a case", make, pays.Printer()) for _ in range(2))
    assert first == second
    assert len(runs) == 1

    committed = json.loads((pays.FOLDER / "result.json").read_text("utf-8"))["machines"]
    title = next(iter(committed))
    monkeypatch.setattr(pays, "sources", lambda *_: iter([(title, None)]))
    assert pays.main(tmp_path, tmp_path)["machines"] == committed
    assert f"{title}: left out" in capsys.readouterr().out


def test_the_page_and_its_figure_show_the_committed_result(pays: ModuleType) -> None:
    result = json.loads((pays.FOLDER / "result.json").read_text("utf-8"))
    assert pays.tables(result) in (pays.FOLDER / "README.md").read_text("utf-8")
    assert pays.figure(result) == (pays.FOLDER / "errors.svg").read_text("utf-8")
    assert len(result["machines"]) >= 4
    for machine in result["machines"].values():
        assert len(machine["lengths"]) >= 4
