"""LeRobot datasets: an episode is a stream of its file and a recording of the dataset."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import run
from lerobot_files import FPS, write_lerobot

from sysid.datasets import Store, ingest
from sysid.errors import InputError
from sysid.logs import ReadOptions, reader_for

Array = npt.NDArray[np.float64]
MOTORS = ["shoulder_pan.pos", "elbow_flex.pos"]
MACHINE = """schema = 1
name = "arm"
rate_hz = 30.0
[[axes]]
name = "pan"
actuation = "position"
drives = "joint"
joint_type = "revolute"
limits = [-3.0, 3.0]
[[axes]]
name = "elbow"
actuation = "position"
drives = "joint"
joint_type = "revolute"
limits = [-3.0, 3.0]
"""
RECIPE = """schema = 1
name = "arm"
machine = "machine.toml"
[[streams]]
files = "*.parquet"
[streams.signals]
"pan.command" = { field = "action[shoulder_pan.pos]", unit = "deg" }
"pan.joint" = { field = "observation.state[shoulder_pan.pos]", unit = "deg" }
"elbow.command" = { field = "action[elbow_flex.pos]", unit = "deg" }
"elbow.joint" = { field = "observation.state[elbow_flex.pos]", unit = "deg" }
"""


def episodes(count: int = 4, seconds: float = 20.0) -> list[tuple[Array, Array]]:
    """Commands that step, states that follow two frames later [deg]."""
    found = []
    for k in range(count):
        rng = np.random.default_rng(k)
        action = np.repeat(rng.uniform(-40.0, 40.0, (int(seconds) + k, 2)), FPS, axis=0)
        found.append((action, np.vstack([action[:1], action[:1], action[:-2]])))
    return found


def test_streams_are_episodes(tmp_path: Path) -> None:
    made = episodes()
    folder = write_lerobot(tmp_path / "wave", made, MOTORS, files=2)
    path = folder / "data/chunk-000/file-001.parquet"
    reader = reader_for(path)
    assert reader.name == "lerobot"
    streams = reader.read(path, ReadOptions())
    assert [stream.name for stream in streams] == ["episode-000002", "episode-000003"]
    stream = streams[1]
    np.testing.assert_array_equal(stream.stamps["episode"], np.round(1e9 * np.arange(len(made[3][0])) / FPS))
    np.testing.assert_allclose(stream.columns["action[elbow_flex.pos]"], made[3][0][:, 1], rtol=1e-6)
    assert set(stream.columns) >= {"observation.state[shoulder_pan.pos]", "frame_index", "task_index"}
    one = reader.read(path, ReadOptions(streams=frozenset({"episode-000002"}), columns=frozenset({"action[elbow_flex.pos]"})))
    assert [(s.name, list(s.columns)) for s in one] == [("episode-000002", ["action[elbow_flex.pos]"])]
    assert "observation.state[elbow_flex.pos]" in one[0].fields


@pytest.mark.parametrize(
    ("names", "label"), [({"motors": MOTORS}, "action[elbow_flex.pos]"), (None, "action[1]"), (["dim"], "action[1]")]
)
def test_names_of_elements(names: dict[str, list[str]] | list[str] | None, label: str, tmp_path: Path) -> None:
    folder = write_lerobot(tmp_path / "wave", episodes(1), names, version="v2.1")
    path = folder / "data/chunk-000/file-000.parquet"
    (stream,) = reader_for(path).read(path, ReadOptions())
    assert label in stream.columns


@pytest.mark.parametrize(
    ("names", "labels"),
    [
        (["pan", "pan"], ["action[0]", "action[1]"]),  # two elements of one name: neither may stand for the other
        (["1", "2"], ['action["1"]', 'action["2"]']),  # identifiers of servos are no places in the list
        (["a[0]", "b"], ["action[0]", "action[b]"]),
    ],
)
def test_names_that_are_no_labels(names: list[str], labels: list[str], tmp_path: Path) -> None:
    made = episodes(1)
    folder = write_lerobot(tmp_path / "wave", made, names)
    (stream,) = reader_for(folder / "data/chunk-000/file-000.parquet").read(
        folder / "data/chunk-000/file-000.parquet", ReadOptions()
    )
    for k, label in enumerate(labels):
        np.testing.assert_allclose(stream.columns[label], made[0][0][:, k], rtol=1e-6)
    assert sum(name.startswith("action") for name in stream.columns) == 2


def test_every_feature_has_a_column_or_a_reason(tmp_path: Path) -> None:
    folder = write_lerobot(tmp_path / "wave", episodes(1), MOTORS)
    path, info = folder / "data/chunk-000/file-000.parquet", folder / "meta/info.json"
    table = pq.read_table(path)
    done = np.arange(len(table)) == len(table) - 1
    more = {
        "next.done": ({"dtype": "bool", "shape": [1], "names": None}, pa.array(done)),
        "gripper": ({"dtype": "uint8", "shape": [1], "names": None}, pa.array(done.astype(np.uint8))),
        "note": ({"dtype": "string", "shape": [1], "names": None}, pa.array(["x"] * len(table))),
        "grid": ({"dtype": "float32", "shape": [1, 2], "names": None}, pa.array([[[0.0, 1.0]]] * len(table))),
    }
    about = json.loads(info.read_text("utf-8"))
    for name, (feature, values) in more.items():
        about["features"][name] = feature
        table = table.append_column(name, values)
    info.write_text(json.dumps(about), "utf-8")
    pq.write_table(table, path)
    (stream,) = reader_for(path).read(path, ReadOptions())
    np.testing.assert_array_equal(stream.columns["next.done"], done)
    np.testing.assert_array_equal(stream.columns["gripper"], done)
    assert stream.unread == {
        "observation.images.front": "values of type video",
        "note": "values of type string",
        "grid": "arrays of shape [1, 2]",
    }
    columns = {name.partition("[")[0] for name in stream.columns} | {"timestamp", "episode_index"}
    assert columns | stream.unread.keys() == about["features"].keys()


def test_uneven_stamps_are_kept(tmp_path: Path) -> None:
    folder = write_lerobot(tmp_path / "wave", episodes(1), MOTORS)
    path = folder / "data/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    shaken = (np.arange(len(table)) / FPS + np.random.default_rng(0).uniform(0.0, 0.01, len(table))).astype(np.float32)
    pq.write_table(table.set_column(table.column_names.index("timestamp"), "timestamp", pa.array(shaken)), path)
    (stream,) = reader_for(path).read(path, ReadOptions())
    np.testing.assert_allclose(stream.stamps["episode"] * 1e-9, shaken, atol=1e-9)


def test_every_episode_is_a_recording(tmp_path: Path) -> None:
    made = episodes()
    folder = write_lerobot(tmp_path / "wave", made, MOTORS, files=2)
    (tmp_path / "machine.toml").write_text(MACHINE, "utf-8")
    (tmp_path / "recipe.toml").write_text(RECIPE, "utf-8")
    dataset = ingest([folder], tmp_path / "ws", recipe=tmp_path / "recipe.toml")
    assert [r.name for r in dataset.recordings] == [f"episode-{k:06d}" for k in range(4)]
    assert sorted(dataset.splits.values()) == ["fit", "fit", "held_out", "select"]
    for k, recording in enumerate(dataset.recordings):
        values = recording.values("pan.joint")
        assert len(recording) == pytest.approx(len(made[k][0]), abs=1)
        np.testing.assert_allclose(values[:500], np.radians(made[k][1][:500, 0]), atol=1e-5)
    stored = Store(tmp_path / "ws").load("arm")
    assert [r.name for r in stored.recordings] == [r.name for r in dataset.recordings]


def test_a_dataset_needs_a_recipe_that_can_be_drafted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_lerobot(tmp_path / "wave", episodes(2), MOTORS)
    (tmp_path / "machine.toml").write_text(MACHINE, "utf-8")
    assert run("--workspace", tmp_path / "ws", "ingest", folder, "--machine", tmp_path / "machine.toml") == 2
    assert "a LeRobot dataset, whose files state no units; expected a recipe" in " ".join(capsys.readouterr().err.split())
    draft = tmp_path / "draft.toml"
    assert run("ingest", "--inspect", folder, "--machine", tmp_path / "machine.toml", "--draft", draft) == 0
    said = capsys.readouterr().out
    assert "episode-000001" in said
    text = draft.read_text("utf-8")
    assert '# "pan.command" = { field = "action[shoulder_pan.pos]", unit = "<unit>" }' in text
    assert '# "elbow.joint" = { field = "observation.state[elbow_flex.pos]", unit = "<unit>" }' in text
    assert text.count("action[elbow_flex.pos]") == 1, "an entry is for all episodes"


@pytest.mark.parametrize(("version", "files"), [("v2.1", 12), ("v3.0", 2)])
def test_the_draft_has_one_entry_for_all_episodes(tmp_path: Path, version: str, files: int) -> None:
    """Version 2 has a file an episode, version 3 several episodes a file."""
    folder = write_lerobot(tmp_path / "wave", episodes(12), MOTORS, files, version)
    if version == "v2.1":
        for path in (folder / "data/chunk-000").iterdir():
            path.rename(path.with_name(f"episode_000{path.stem[-3:]}.parquet"))
    (tmp_path / "machine.toml").write_text(MACHINE, "utf-8")
    draft = tmp_path / "recipe.toml"
    assert run("ingest", "--inspect", folder, "--draft", draft) == 0
    text = draft.read_text("utf-8")
    assert text.count("[[streams]]") == 1
    assert len(text.splitlines()) < 30
    filled = re.sub(r'^# ("(pan|elbow)\.[^<]*unit = )"<unit>"', r'\1"deg"', text, flags=re.MULTILINE)
    draft.write_text(filled, "utf-8")
    dataset = ingest([folder], tmp_path / "ws", recipe=draft)
    assert [recording.name for recording in dataset.recordings] == [f"episode-{k:06d}" for k in range(12)]


def test_damaged_datasets(tmp_path: Path) -> None:
    folder = write_lerobot(tmp_path / "wave", episodes(2), MOTORS)
    path, info = folder / "data/chunk-000/file-000.parquet", folder / "meta/info.json"
    good, table = json.loads(info.read_text()), pq.read_table(path)

    def message(**changes: object) -> str:
        info.write_text(json.dumps({**good, **changes}), "utf-8")
        with pytest.raises(InputError) as error:
            reader_for(path).read(path, ReadOptions())
        return str(error.value)

    assert "codebase_version 'v1.6'; expected v2.0, v2.1 or v3.0" in message(codebase_version="v1.6")
    assert "no features in meta/info.json" in message(features=None)
    longer = {**good["features"], "action": {"dtype": "float32", "shape": [3], "names": None}}
    assert "action: lists of another length than 3" in message(features=longer)
    assert "no column 'torque'" in message(features={**good["features"], "torque": longer["action"]})
    info.write_text(json.dumps(good), "utf-8")
    pq.write_table(pa.concat_tables([table, table]), path)
    with pytest.raises(InputError, match="rows of one episode in several places"):
        reader_for(path).read(path, ReadOptions())
    path.write_bytes(b"PAR1 and no more")
    with pytest.raises(InputError, match="not readable as Parquet"):
        reader_for(path).read(path, ReadOptions())
    info.write_text("{", "utf-8")
    with pytest.raises(InputError, match="not readable as JSON"):
        reader_for(path)
