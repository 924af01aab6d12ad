"""The parts of one bag are one recording: in the draft, with a recipe, and without one."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from mcap.writer import Writer

from sysid.datasets import Store, ingest
from sysid.errors import InputError

MACHINE = (
    'schema = 1\nname = "rig"\nrate_hz = 50.0\n[[axes]]\nname = "boom"\nactuation = "velocity"\ndrives = "joint"\ngain = 1.0\n'
)
RATE, PARTS, ROWS = 50.0, 3, 400


def part(path: Path, number: int, pause_s: float = 0.0, rows: int = ROWS) -> None:
    """Part ``number`` of a motion; a part begins ``pause_s`` later than the next row of the one before."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = [writer.register_channel(topic, "json", 0) for topic in ("/valves", "/sensors")]
        for k in range(number * ROWS, number * ROWS + rows):
            t = k / RATE
            stamp = int(1e9 * (1.7e9 + t + number * pause_s))
            texts = ({"boom.command": float(np.sin(t))}, {"boom.joint": 1.0 - float(np.cos(t))})
            for channel, text in zip(channels, texts, strict=True):
                writer.add_message(channel, stamp, json.dumps(text).encode(), stamp)
        writer.finish()


def bag(folder: Path, pause_s: float = 0.0, metadata: bool = True) -> Path:
    folder.mkdir(parents=True)
    names = [f"run_{k}.mcap" for k in range(PARTS)]
    for k, name in enumerate(names):
        part(folder / name, k, pause_s)
    if metadata:
        listed = "".join(f"    - {name}\n" for name in names)
        text = f"rosbag2_bagfile_information:\n  version: 9\n  relative_file_paths:\n{listed}"
        (folder / "metadata.yaml").write_text(text)
    return folder


RECIPE = """schema = 1
machine = "machine.toml"
[[streams]]
files = "*.mcap"
[streams.signals]
"boom.joint" = { topic = "/sensors", field = "boom.joint" }
"boom.command" = { topic = "/valves", field = "FIELD" }
"""


def test_a_topic_without_messages_in_one_part(tmp_path: Path) -> None:
    """A command that is sent on change is not in every part; one that is in no part is a mistake of the recipe."""
    folder = bag(tmp_path / "first")
    with (folder / "run_1.mcap").open("wb") as file:  # without commands
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/sensors", "json", 0)
        for k in range(ROWS, 2 * ROWS):
            stamp = int(1e9 * (1.7e9 + k / RATE))
            writer.add_message(channel, stamp, json.dumps({"boom.joint": 1.0 - float(np.cos(k / RATE))}).encode(), stamp)
        writer.finish()
    (tmp_path / "machine.toml").write_text(MACHINE)
    recipe = tmp_path / "recipe.toml"
    assert run("ingest", "--inspect", folder, "--draft", recipe) == 0
    (entry,) = tomllib.loads(recipe.read_text("utf-8"))["streams"]
    assert entry["signals"] == {"boom.command": {"topic": "/valves", "field": "boom.command"}}
    recipe.write_text(RECIPE.replace("FIELD", "boom.command"))
    dataset = ingest([folder], tmp_path / "ws", recipe=recipe)
    (lost,) = [loss for source in dataset.sources for loss in source.losses]
    assert lost == "boom.command: no 'boom.command' of '/valves' in this part of the bag"
    assert sum(len(recording.table) for recording in dataset.recordings) > 0.8 * PARTS * ROWS
    recipe.write_text(RECIPE.replace("FIELD", "boom"))
    with pytest.raises(InputError, match=r"boom\.command: no 'boom' of '/valves' in any of its files"):
        ingest([folder], tmp_path / "ws", recipe=recipe)


def lengths(workspace: Path) -> dict[str, int]:
    found = {recording.name.partition("#")[0]: 0 for recording in Store(workspace).load("rig").recordings}
    for recording in Store(workspace).load("rig").recordings:
        found[recording.name.partition("#")[0]] += len(recording.table)
    return found


@pytest.mark.parametrize("beside", [False, True], ids=["bag", "folder of bags"])
def test_a_bag_without_a_recipe(tmp_path: Path, beside: bool) -> None:
    folder = bag(tmp_path / "logs/first")
    if beside:
        bag(tmp_path / "logs/second")
    (tmp_path / "logs/machine.toml").write_text(MACHINE)
    assert run("--workspace", tmp_path / "ws", "ingest", tmp_path / "logs" if beside else folder) == 0
    found = lengths(tmp_path / "ws")
    assert set(found) == ({"first", "second"} if beside else {"first"})
    assert all(rows > 0.8 * PARTS * ROWS for rows in found.values())


@pytest.mark.parametrize(
    ("metadata", "pause_s", "recordings"), [(True, 0.0, 1), (True, 2.0, 1), (False, 0.0, 1), (False, 2.0, PARTS)]
)
def test_the_draft_of_a_bag(tmp_path: Path, metadata: bool, pause_s: float, recordings: int) -> None:
    """Without metadata the parts are one recording where each continues the one before; after a pause they may be several."""
    folder = bag(tmp_path / "first", pause_s, metadata)
    (tmp_path / "machine.toml").write_text(MACHINE)
    draft = tmp_path / "recipe.toml"
    assert run("ingest", "--inspect", folder, "--draft", draft) == 0
    recipe = tomllib.loads(draft.read_text("utf-8"))
    assert len(recipe.get("recordings", {}).get("files", {})) == (recordings if recordings > 1 else 0)
    assert len(recipe["streams"]) == 1
    assert run("--workspace", tmp_path / "ws", "ingest", folder, "--recipe", draft) == 0
    assert len(lengths(tmp_path / "ws")) == recordings


@pytest.mark.parametrize("listed", [False, True], ids=["by their names", "one by its metadata"])
@pytest.mark.parametrize("names", [("first", "second"), ("run", "run_b")])
def test_several_split_bags_in_one_folder(tmp_path: Path, listed: bool, names: tuple[str, str]) -> None:
    """Each is a recording: the parts in the metadata, and those whose names count up and that continue each other."""
    folder = bag(tmp_path / "logs", metadata=listed)
    for k in range(PARTS):
        (folder / f"run_{k}.mcap").rename(folder / f"{names[0]}_{k}.mcap")
        part(folder / f"{names[1]}_{k}.mcap", k + 100)
    part(folder / "alone.mcap", 300)
    if listed:
        metadata = folder / "metadata.yaml"
        metadata.write_text(metadata.read_text("utf-8").replace("run_", f"{names[0]}_"), "utf-8")
    (tmp_path / "machine.toml").write_text(MACHINE)
    draft = tmp_path / "recipe.toml"
    assert run("ingest", "--inspect", folder, "--draft", draft) == 0
    recipe = tomllib.loads(draft.read_text("utf-8"))
    assert run("--workspace", tmp_path / "ws", "ingest", folder, "--recipe", draft) == 0
    found = lengths(tmp_path / "ws")
    if names[0] == "first":
        assert set(found) == {"first", "second", "alone"} == set(recipe["recordings"]["files"])
        assert recipe["recordings"]["files"]["second"] == "second_*.mcap"
    else:  # no glob tells run_0 … run_2 from run_b_0 …: these are recordings by themselves
        assert set(found) == {"run_b", "alone", *(f"run_{k}" for k in range(PARTS))}
    assert sum(found.values()) > 0.8 * (2 * PARTS + 1) * ROWS
