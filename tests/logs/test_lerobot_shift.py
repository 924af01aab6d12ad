"""A LeRobot dataset written again with later actions: the values, what stays, the statistics, and nothing half-written."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import run
from hypothesis import given
from hypothesis import strategies as st
from lerobot_files import FPS, write_lerobot

from sysid.datasets import ingest
from sysid.datasets.quality.responses import responses_of
from sysid.errors import InputError, SettingsError
from sysid.logs.lerobot import LeRobotReader, data_files
from sysid.logs.lerobot_shift import write_shifted
from sysid.logs.reader import ReadOptions

Array = npt.NDArray[np.float64]
PARTS = ("pan", "lift")
NAMES = [f"{part}.pos" for part in PARTS]


def episodes(count: int, rows: int = 40) -> list[tuple[Array, Array]]:
    rng = np.random.default_rng(0)
    return [(rng.normal(size=(rows, 2)), rng.normal(size=(rows, 2))) for _ in range(count)]


def statistics(values: Array) -> dict[str, Any]:
    by_key = {key: getattr(np, key)(values, axis=0).tolist() for key in ("min", "max", "mean", "std")}
    return {**by_key, "count": [len(values)], "q10": np.quantile(values, 0.1, axis=0).tolist()}


def with_statistics(folder: Path, made: list[tuple[Array, Array]], **more: Any) -> Path:
    """Statistics of actions and states as versions 2.1 and 3 store them."""
    parts = {"action": [a for a, _ in made], "observation.state": [s for _, s in made]}
    whole = {feature: statistics(np.concatenate(own)) | more for feature, own in parts.items()}
    (folder / "meta/stats.json").write_text(json.dumps(whole))
    each = [{feature: statistics(own[k]) for feature, own in parts.items()} for k in range(len(made))]
    lines = [json.dumps({"episode_index": k, "stats": stats}) for k, stats in enumerate(each)]
    (folder / "meta/episodes_stats.jsonl").write_text("\n".join(lines))
    columns = {f"stats/{f}/{key}": [stats[f][key] for stats in each] for f in parts for key in each[0][f]}
    pq.write_table(
        pa.table({"episode_index": range(len(made)), **columns}), folder / "meta/episodes/chunk-000/file-000.parquet"
    )
    return folder


def read(folder: Path) -> dict[str, dict[str, Array]]:
    """Episode → column → values."""
    streams = [s for file in data_files(folder) for s in LeRobotReader().read(file, ReadOptions())]
    return {stream.name: {**stream.columns} for stream in streams}


@pytest.mark.parametrize("frames", [3, -2, 0])
def test_whole_frames_move_and_the_rest_stays(tmp_path: Path, frames: int) -> None:
    made = episodes(3)
    folder = with_statistics(write_lerobot(tmp_path / "set", made, NAMES, files=2), made)
    write_shifted(folder, tmp_path / "late", {"action[lift.pos]": frames / FPS})
    before, after = read(folder), read(tmp_path / "late")
    rows = np.clip(np.arange(40) - frames, 0, 39)
    for episode, columns in before.items():
        for name, values in columns.items():
            expected = values[rows] if name == "action[lift.pos]" else values
            np.testing.assert_allclose(after[episode][name], expected, atol=1e-6, err_msg=name)
    tables = [pq.read_table(f / "data/chunk-000/file-000.parquet") for f in (folder, tmp_path / "late")]
    assert tables[0].schema == tables[1].schema
    actions = [np.column_stack([after[f"episode-00000{k}"][f"action[{name}]"] for name in NAMES]) for k in range(3)]
    whole = json.loads((tmp_path / "late/meta/stats.json").read_text())
    each = [json.loads(line) for line in (tmp_path / "late/meta/episodes_stats.jsonl").read_text().splitlines()]
    table = pq.read_table(tmp_path / "late/meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for key, value in statistics(np.concatenate(actions)).items():
        assert whole["action"][key] == pytest.approx(value, abs=1e-6)
    for k, own in enumerate(actions):
        for key, value in statistics(own).items():
            assert each[k]["stats"]["action"][key] == pytest.approx(value, abs=1e-6)
            assert table[k][f"stats/action/{key}"] == pytest.approx(value, abs=1e-6)
        assert each[k]["stats"]["observation.state"] == statistics(made[k][1])
    assert (tmp_path / "late/meta/info.json").read_bytes() == (folder / "meta/info.json").read_bytes()


@given(st.floats(-1.0, 1.0))
def test_a_ramp_is_late_by_the_delay(tmp_path_factory: pytest.TempPathFactory, delay: float) -> None:
    ramp = np.column_stack([np.arange(60.0), np.zeros(60)])
    folder = write_lerobot(tmp_path_factory.mktemp("set"), [(ramp, ramp)], NAMES)
    out = tmp_path_factory.mktemp("out") / "late"
    write_shifted(folder, out, {"action[pan.pos]": delay})
    found = read(out)["episode-000000"]["action[pan.pos]"]
    np.testing.assert_allclose(found, np.clip(np.arange(60.0) - delay * FPS, 0.0, 59.0), atol=1e-4)


def test_a_statistic_that_is_not_known_leaves_nothing_half_written(tmp_path: Path) -> None:
    made = episodes(1)
    folder = with_statistics(write_lerobot(tmp_path / "set", made, NAMES), made, entropy=[1.0])
    with pytest.raises(InputError) as refused:
        write_shifted(folder, tmp_path / "late", {"action[pan.pos]": 0.1})
    assert refused.value.found == "'entropy'"
    assert [path.name for path in tmp_path.iterdir()] == ["set"]


def test_a_damaged_file_is_refused_and_leaves_nothing_half_written(tmp_path: Path) -> None:
    folder = write_lerobot(tmp_path / "set", episodes(2), NAMES, files=2)
    (folder / "data/chunk-000/file-001.parquet").write_bytes(b"PAR1 cut off")
    with pytest.raises(InputError) as refused:
        write_shifted(folder, tmp_path / "late", {"action[pan.pos]": 0.1})
    assert refused.value.where == str(folder / "data/chunk-000/file-001.parquet")
    assert refused.value.expected == "a data file of a LeRobot dataset"
    assert [path.name for path in tmp_path.iterdir()] == ["set"]


def test_only_a_new_folder_and_known_elements(tmp_path: Path) -> None:
    folder = write_lerobot(tmp_path / "set", episodes(1), NAMES)
    with pytest.raises(SettingsError) as refused:
        write_shifted(folder, tmp_path / "late", {"action[pan]": 0.1})
    assert refused.value.expected.startswith("'action[pan.pos]'? ")
    (tmp_path / "late").mkdir()
    with pytest.raises(SettingsError) as refused:
        write_shifted(folder, tmp_path / "late", {"action[pan.pos]": 0.1})
    assert refused.value.found == "is there already"
    with pytest.raises(SettingsError) as refused:
        write_shifted(folder, folder / "late", {"action[pan.pos]": 0.1})
    assert refused.value.found == f"is in {folder}"
    with pytest.raises(InputError):
        write_shifted(tmp_path / "late", tmp_path / "other", {})


def test_the_command_removes_the_delay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = []
    for number in range(4):
        rng, time = np.random.default_rng(number), np.arange(600) / FPS
        frequency, phase = rng.uniform(0.1, 0.8, (2, 4)), rng.uniform(0.0, 6.0, (2, 4))
        action, state = (
            np.column_stack([10.0 * np.sin(2.0 * np.pi * np.outer(time - lag, f) + p).sum(axis=1) for f, p, lag in parts])
            for parts in (zip(frequency, phase, (0.0, 0.0), strict=True), zip(frequency, phase, (0.05, 0.21), strict=True))
        )
        made.append((action, state))
    folder, workspace = write_lerobot(tmp_path / "wave", made, NAMES), tmp_path / "ws"
    machine = "".join(
        f'[[axes]]\nname = "{name}"\nactuation = "position"\ndrives = "joint"\nlimits = [-3.0, 3.0]\n' for name in PARTS
    )
    (folder / "machine.toml").write_text(f'schema = 1\nname = "wave"\nrate_hz = {float(FPS)}\n{machine}')
    signals = "".join(
        f'"{name}.command" = {{ field = "action[{name}.pos]", unit = "deg" }}\n'
        f'"{name}.joint" = {{ field = "observation.state[{name}.pos]", unit = "deg" }}\n'
        for name in PARTS
    )
    recipe = f'schema = 1\n[[streams]]\nfiles = "*.parquet"\nreader = "lerobot"\n[streams.signals]\n{signals}'
    (folder / "recipe.toml").write_text(recipe)
    ingest(folder, workspace)
    assert run("--workspace", workspace, "datasets", "shift", "wave", folder, "--out", tmp_path / "late") == 0
    assert "made" in capsys.readouterr().out
    delays = [response.delay for response in responses_of(ingest(tmp_path / "late", tmp_path / "again"))]
    assert delays == pytest.approx([0.0, 0.0], abs=0.004)  # the first actions are held
    shutil.rmtree(tmp_path / "late")
    assert run("--workspace", workspace, "datasets", "shift", "wave", tmp_path, "--out", tmp_path / "late") == 2
    assert "no LeRobot dataset" in capsys.readouterr().err
