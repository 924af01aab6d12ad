"""Files that cannot be used: all are named at once, and left out only where the recipe says so, which is counted."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lerobot_files import write_lerobot

from sysid.datasets import Dataset, Store, ingest
from sysid.datasets.drafting import describe
from sysid.datasets.drafting.fields import Answers
from sysid.errors import InputError, SettingsError
from sysid.execution import LocalExecutor
from sysid.logs.inspection import inspect_file
from sysid.reports import ReportInputs, build_report

MACHINE = """schema = 1
name = "arm"
rate_hz = 30.0
[[axes]]
name = "pan"
actuation = "position"
drives = "joint"
joint_type = "revolute"
limits = [-3.0, 3.0]
"""
HEAD = "time,pan.command,pan.joint\n"


def rows(seed: int, count: int = 300) -> list[str]:
    rng = np.random.default_rng(seed)
    command = np.repeat(rng.uniform(-1.0, 1.0, count // 30 + 1), 30)[:count]
    return [f"{i / 30:.5f},{u:.5f},{0.9 * u:.5f}\n" for i, u in enumerate(command)]


def ragged(lines: list[str]) -> bytes:
    return (HEAD + "".join([*lines[:50], "1.0,2.0\n", *lines[50:]])).encode()


def binary(lines: list[str]) -> bytes:
    return b"\x00\x01\x02garbage\xff\xfe" + lines[0].encode()


def unknown(lines: list[str]) -> bytes:
    return ("time,pan.command,pam.joint\n" + "".join(lines)).encode()


def backwards(lines: list[str]) -> bytes:
    return (HEAD + "".join([*lines[100:], *lines[:100]])).encode()


def empty(lines: list[str]) -> bytes:
    return b""


#: What a file is instead of a log → what the error says of it.
DAMAGES = {
    ragged: "2 values; expected 3",
    binary: "no text",
    unknown: "unknown column 'pam.joint'",
    backwards: "back in time",
    empty: "empty",
}


def folder(tmp: Path, damages: dict[str, str], recordings: int) -> Path:
    """Recordings ``run-0``, …; ``damages``: recording → name of what its log has instead."""
    by_name = {damage.__name__: damage for damage in DAMAGES}
    logs = tmp / "logs"
    for k in range(recordings):
        (logs / f"run-{k}").mkdir(parents=True)
        lines = rows(k)
        name = damages.get(f"run-{k}")
        content = (HEAD + "".join(lines)).encode() if name is None else by_name[name](lines)
        (logs / f"run-{k}/log.csv").write_bytes(content)
    (logs / "machine.toml").write_text(MACHINE, "utf-8")
    return logs


def refusal(logs: Path, workspace: Path, **options: object) -> str:
    with pytest.raises(InputError) as caught:
        ingest(logs, workspace, **options)  # type: ignore[arg-type]
    return str(caught.value)


def follow(message: str) -> Path:
    """Do what the remedy says, to the letter."""
    table, key, place, first = re.findall(
        r"write `(.*?)` and below it `(.*?)` in a file (.*?), whose first line is `(.*?)`", message
    )[0]
    Path(place).write_text("\n".join((first, table, key)) + "\n", "utf-8")
    return Path(place)


def counted(dataset: Dataset, keys: list[str]) -> None:
    (note,) = (note for note in dataset.quality["notes"] if "left out by the recipe" in note)
    assert note.startswith(f"{len(keys)} file")
    assert all(key in note for key in keys)


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_every_bad_file_is_named_and_the_remedy_works(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    tmp = tmp_path_factory.mktemp("bad")
    count = data.draw(st.integers(2, 6))
    bad = data.draw(st.dictionaries(st.integers(0, count - 1), st.sampled_from([d.__name__ for d in DAMAGES]), min_size=1))
    damages = {f"run-{k}": name for k, name in bad.items() if len(bad) < count or k > 0}  # one is good
    logs = folder(tmp, damages, count)
    if not damages:
        return
    message = refusal(logs, tmp / "ws")
    for damage, text in DAMAGES.items():
        own = [name for name, what in damages.items() if what == damage.__name__]
        assert all(str(logs / name / "log.csv") in message for name in own)
        assert text in message or not own
    assert not any(str(logs / f"run-{k}/log.csv") in message for k in range(count) if f"run-{k}" not in damages)
    assert len(damages) == 1 or message.startswith(f"{len(damages)} of {count} files cannot be used")
    follow(message)
    dataset = ingest(logs, tmp / "ws")
    kept = {re.sub(r"-block.*|#.*", "", recording.name) for recording in dataset.recordings}
    assert not kept & damages.keys()
    counted(Store(tmp / "ws").load("arm"), [f"{name}/log.csv" for name in damages])
    assert {source.path for source in dataset.sources} == {f"run-{k}/log.csv" for k in range(count)} - {
        f"{name}/log.csv" for name in damages
    }


def test_tasks_name_them_all_too_and_give_the_same_version(tmp_path: Path) -> None:
    logs = folder(tmp_path, {"run-1": "ragged", "run-3": "binary"}, 5)
    alone = refusal(logs, tmp_path / "alone")
    assert refusal(logs, tmp_path / "tasks", executor=LocalExecutor()) == alone
    follow(alone)
    one, other = ingest(logs, tmp_path / "alone"), ingest(logs, tmp_path / "tasks", executor=LocalExecutor())
    assert one.digest == other.digest
    assert one.quality["notes"] == other.quality["notes"]


def test_where_all_files_are_bad_leaving_them_out_is_no_remedy(tmp_path: Path) -> None:
    message = refusal(folder(tmp_path, {"run-0": "unknown", "run-1": "unknown"}, 2), tmp_path / "ws")
    assert "left_out" not in message
    assert message.count("unknown column 'pam.joint'") == 1  # one reason, two files
    assert all(f"run-{k}/log.csv" in message for k in range(2))


def test_one_of_two_files_of_a_recording(tmp_path: Path) -> None:
    logs = folder(tmp_path, {}, 3)
    for k in range(3):
        text = "".join(line.rpartition(",")[0] + "\n" for line in ["time,pan.speed,x\n", *rows(k)])
        (logs / f"run-{k}/speed.csv").write_text(text if k != 1 else "time,pan.speed\n0.0\n0.1,1.0\n0.2,1.0\n", "utf-8")
    follow(refusal(logs, tmp_path / "ws"))
    dataset = ingest(logs, tmp_path / "ws")
    assert {"run-0", "run-1", "run-2"} == {recording.name for recording in dataset.recordings}
    counted(dataset, ["run-1/speed.csv"])


@pytest.mark.parametrize("flat", [False, True])
def test_a_draft_leaves_out_what_cannot_be_read_and_says_so(
    flat: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = folder(tmp_path, {"run-1": "ragged", "run-2": "binary"}, 5)
    if flat:  # each file is a recording of its own
        for k in range(5):
            (logs / f"run-{k}/log.csv").rename(logs / f"run-{k}.csv")
            (logs / f"run-{k}").rmdir()
    draft = tmp_path / "draft.toml"
    assert run("ingest", logs, "--inspect", "--machine", logs / "machine.toml", "--draft", draft) == 0
    draft.write_text(re.sub(r'^# ("pan.*?)"<unit>"', r'\1"rad"', draft.read_text("utf-8"), flags=re.M), "utf-8")
    assert "line 52: 2 values" in draft.read_text("utf-8")
    capsys.readouterr()
    assert run("--workspace", tmp_path / "ws", "ingest", logs, "--recipe", draft) == 0
    names = ["run-1/run-1.csv", "run-2/run-2.csv"] if flat else ["run-1/log.csv", "run-2/log.csv"]
    assert f"2 files left out by the recipe: {', '.join(names)}" in " ".join(capsys.readouterr().out.split())
    dataset = Store(tmp_path / "ws").load("arm")
    counted(dataset, names)
    assert sorted(recording.name for recording in dataset.recordings) == ["run-0", "run-3", "run-4"]


def test_data_files_of_a_lerobot_dataset(tmp_path: Path) -> None:
    made = [(np.zeros((60, 2)) + k, np.zeros((60, 2)) + np.arange(60)[:, None]) for k in range(4)]
    logs = write_lerobot(tmp_path / "wave", made, ["pan.pos", "elbow.pos"], files=4)
    for k in (1, 2):
        (logs / f"data/chunk-000/file-00{k}.parquet").write_bytes(b"PAR1 cut off")
    recipe = tmp_path / "recipe.toml"
    text = (
        'schema = 1\nname = "arm"\n[[streams]]\nfiles = "*.parquet"\n[streams.signals]\n'
        '"pan.command" = { field = "action[pan.pos]", unit = "deg" }\n'
        '"pan.joint" = { field = "observation.state[pan.pos]", unit = "deg" }\n'
    )
    recipe.write_text(text, "utf-8")
    (tmp_path / "machine.toml").write_text(MACHINE, "utf-8")
    message = refusal(logs, tmp_path / "ws", recipe=recipe)
    assert message.startswith("2 of 4 files cannot be used")
    table, key = re.findall(r"write `(.*?)` and below it `(.*?)` in the recipe", message)[0]
    recipe.write_text(text.replace("[[streams]]", f"{table}\n{key}\n[[streams]]"), "utf-8")
    dataset = ingest(logs, tmp_path / "ws", recipe=recipe)
    assert {recording.name for recording in dataset.recordings} == {"episode-000000", "episode-000003"}
    counted(dataset, ["chunk-000/file-001.parquet", "chunk-000/file-002.parquet"])


def test_a_name_that_is_not_there_is_a_mistake(tmp_path: Path) -> None:
    logs = folder(tmp_path, {}, 2)
    (logs / "recipe.toml").write_text('schema = 1\n[recordings]\nleft_out = ["run-1/lug.csv"]\n', "utf-8")
    with pytest.raises(SettingsError, match=r"recordings.left_out: no file 'run-1/lug.csv'; expected 'run-1/log.csv'\?"):
        ingest(logs, tmp_path / "ws")
    (logs / "recipe.toml").write_text('schema = 1\n[recordings]\nleft_out = ["*/log.csv"]\n', "utf-8")
    with pytest.raises(InputError, match=r"no log files|no recordings"):
        ingest(logs, tmp_path / "ws")


def test_the_recipe_of_start_leaves_them_out_too(tmp_path: Path) -> None:
    logs = folder(tmp_path, {"run-1": "ragged"}, 4)
    drafted = describe([inspect_file(path) for path in sorted(logs.glob("*/*.csv"))], logs, "arm", Answers({}))
    assert any("line 52: 2 values" in line for line in drafted.left_out)
    for name, text in (("machine.toml", drafted.machine), ("recipe.toml", drafted.recipe)):
        (logs / name).write_text(text, "utf-8")
    dataset = ingest(logs, tmp_path / "ws")
    assert "run-1" not in {recording.name for recording in dataset.recordings}
    counted(dataset, ["run-1/log.csv"])


def test_the_report_says_what_was_left_out(tmp_path: Path) -> None:
    logs = folder(tmp_path, {"run-1": "binary"}, 4)
    follow(refusal(logs, tmp_path / "ws"))
    assert "1 file left out by the recipe: run-1/log.csv" in build_report(ReportInputs(ingest(logs, tmp_path / "ws")))
