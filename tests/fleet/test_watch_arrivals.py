"""What arrives in a log folder: complete, in part, again, under another name, changed, or nothing that is a log."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import socket
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from fleet_logs import one_lift
from log_feed import write_log

from sysid.datasets import Store, ingest
from sysid.datasets.versions.manifest import contents_of
from sysid.errors import SettingsError, StoreError
from sysid.fleet import arrivals, watch, watching
from sysid.fleet.arrivals import Arrivals, SeenLogs
from sysid.fleet.effects import FleetEffect
from sysid.fleet.result import FleetMachine

DEADBAND = FleetEffect("valve_deadband", "boom", None, ("positive", "negative"))


class Watched:
    """A workspace with four recordings, which are in ``begun`` too, and a log folder beside it."""

    def __init__(self, folder: Path, begun: Path) -> None:
        self.begun, self.logs, self.workspace = begun / "begun", folder / "logs", folder / "workspace"
        self.logs.mkdir()
        shutil.copytree(begun / "workspace", self.workspace)
        self.store, self.seen = Store(self.workspace), SeenLogs()
        self.fixed = [*contents_of(self.store.manifest("lift-1@1"))]

    def look(self) -> Arrivals:
        found, self.seen = arrivals.take_in([self.logs], self.store, "lift-1", self.fixed, 0.0, self.seen)
        return found

    def put(self, name: str, seed: int = 100, share: float = 1.0) -> Path:
        path = self.logs / name / "log.csv"
        write_log(path, seed)
        content = path.read_bytes()
        path.write_bytes(content[: round(share * len(content))])
        return path

    @property
    def rows(self) -> dict[str, int]:
        """Recordings beside those of the beginning, with their rows."""
        names = [r.name for r in self.store.load("lift-1").recordings]
        assert len(names) == len(set(names))
        channels = self.store.channels("lift-1").groupby(["recording", "signal"]).size()
        rows = {r.name: len(r) for r in self.store.load("lift-1").recordings if not r.name.startswith("run-")}
        assert {str(name) for name, _ in channels.index if not str(name).startswith("run-")} == set(rows)
        for name, count in rows.items():
            assert channels[name, "boom.joint"] == pytest.approx(count, abs=1)
        return rows


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with four recordings and their workspace, in which the watch has begun."""
    folder = tmp_path_factory.mktemp("begun")
    one_lift(folder / "begun")
    ingest(folder / "begun", folder / "workspace", name="lift-1")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(watching, "name_effects", name_effects)
        watch(folder / "workspace", "lift-1")
    return folder


@pytest.fixture
def lift(tmp_path: Path, begun: Path) -> Watched:
    return Watched(tmp_path, begun)


def test_a_part_is_replaced_when_the_whole_is_there(lift: Watched) -> None:
    lift.put("a", 100, 0.5)
    lift.put("b", 101)
    assert set(lift.look().added) == {"a", "b"}
    half = lift.rows["a"]
    assert lift.look() == Arrivals()
    lift.put("a", 100)
    found = lift.look()
    assert (found.added, found.replaced) == ((), (("a", "a"),))
    assert half < 250
    assert lift.rows == {"a": 400, "b": 400}
    names = [r.name for r in lift.store.load("lift-1").recordings]
    assert names[-2:] == ["a", "b"]  # in its place
    assert lift.store.load("lift-1@2").recording("a").table.shape[0] == half  # a version never changes
    assert lift.look() == Arrivals()


def test_other_content_of_the_same_size_and_time_is_noticed(lift: Watched) -> None:
    path = lift.put("a", 100)
    at = path.stat().st_mtime_ns
    lift.look()
    content = path.read_bytes()
    path.write_bytes(content[:-2] + (b"1\n" if content[-2:] == b"2\n" else b"2\n"))
    os.utime(path, ns=(at, at))
    assert lift.look().replaced == (("a", "a"),)


@pytest.mark.parametrize("year", [-3.2e7, 3.2e7])
def test_clocks_ahead_and_behind_do_not_matter(lift: Watched, year: float) -> None:
    path = lift.put("a")
    at = path.stat().st_mtime + year
    os.utime(path, (at, at))
    assert lift.look().added == ("a",)


def test_a_copy_is_not_counted_whichever_way_it_comes(lift: Watched) -> None:
    lift.put("a")
    lift.put("a-again")
    found = lift.look()
    assert (found.added, found.repeated) == (("a",), (("a-again", "a"),))
    lift.put("slow", share=0.4)  # the beginning of a copy is a recording until it is whole
    assert lift.look().added == ("slow",)
    lift.put("slow")
    found = lift.look()
    assert found.repeated == (("a-again", "a"), ("slow", "a"))
    assert found.replaced == (("slow", "a"),)
    assert lift.rows == {"a": 400}
    assert lift.look() == Arrivals(repeated=found.repeated)


@pytest.mark.parametrize("order", [*itertools.permutations(("a", "b", "c"))], ids="".join)
def test_of_copies_the_first_by_name_counts_in_whichever_order_they_come(lift: Watched, order: tuple[str, ...]) -> None:
    for name in order:
        lift.put(name, share=0.5 if name == "b" else 1.0)
        lift.look()
    lift.put("b")
    for _ in range(2):
        lift.look()
    assert lift.rows == {"a": 400}
    assert lift.look() == Arrivals(repeated=(("b", "a"), ("c", "a")))


def test_the_beginning_of_a_recording_under_another_name_is_part_of_it(lift: Watched) -> None:
    lift.put("half", share=0.4)
    lift.look()
    lift.put("whole")
    found = lift.look()
    assert found.replaced == (("half", "whole"),)
    assert lift.rows == {"whole": 400}
    found = lift.look()  # its folder is still there
    assert found == Arrivals(repeated=(("half", "whole"),))
    lift.put("half", 101)
    assert lift.look().added == ("half",)
    assert lift.rows == {"half": 400, "whole": 400}


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_a_recording_that_is_renamed_keeps_its_new_name(lift: Watched, share: float) -> None:
    lift.put("incoming", share=share)
    lift.look()
    lift.put("incoming")
    (lift.logs / "incoming").rename(lift.logs / "final")
    assert lift.look().replaced == (("incoming", "final"),)
    assert lift.rows == {"final": 400}
    shutil.rmtree(lift.logs / "final")  # what was taken in stays
    assert lift.look() == Arrivals()
    assert lift.rows == {"final": 400}


def test_names_that_change_places(lift: Watched) -> None:
    lift.put("a", 100)
    lift.put("b", 101)
    lift.look()
    for old, new in (("a", "x"), ("b", "a"), ("x", "b")):
        (lift.logs / old).rename(lift.logs / new)
    for _ in range(3):
        lift.look()
    assert lift.rows == {"a": 400, "b": 400}
    starts = {r.name: r.start_ns for r in lift.store.load("lift-1").recordings}
    assert starts["a"] > starts["b"]


def test_a_recording_of_the_beginning_that_changes_is_named(lift: Watched) -> None:
    lift.put("run-0", 100)
    found = lift.look()
    assert [name for name, _ in found.left_out] == ["run-0"]
    assert "--restart" in found.left_out[0][1]
    shutil.copytree(lift.begun / "run-1", lift.logs / "run-1")  # it is held as it is
    assert lift.look() == found


def bad_link(logs: Path) -> None:
    (logs / "bad").symlink_to(logs / "good")


def bad_loop(logs: Path) -> None:
    (logs / "bad").symlink_to("bad")


def bad_pipe(logs: Path) -> None:
    os.mkfifo(logs / "bad")


def bad_socket(logs: Path) -> None:
    before = Path.cwd()
    os.chdir(logs)  # its path has at most 107 bytes
    try:
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind("bad")
    finally:
        os.chdir(before)


def bad_linked_log(logs: Path) -> None:
    (logs / "bad").mkdir()
    (logs / "bad" / "log.csv").symlink_to("/dev/zero")


def bad_piped_log(logs: Path) -> None:
    (logs / "bad").mkdir()
    os.mkfifo(logs / "bad" / "log.mcap")


def bad_empty_log(logs: Path) -> None:
    (logs / "bad").mkdir()
    (logs / "bad" / "log.csv").touch()


def bad_no_log(logs: Path) -> None:
    (logs / "bad").mkdir()
    (logs / "bad" / "log.mcap").write_bytes(b"no log")


def bad_other_file(logs: Path) -> None:
    (logs / "bad").mkdir()
    (logs / "bad" / "notes.txt").write_text("nothing")


def bad_deep(logs: Path) -> None:
    (logs / "bad" / "/".join(["d"] * 40)).mkdir(parents=True)
    (logs / "bad" / "log.csv").write_text("time\n1\n")


def bad_log_beside(logs: Path) -> None:
    shutil.copy(logs / "good" / "log.csv", logs / "bad.csv")


def bad_no_signal(logs: Path) -> None:
    (logs / "bad").mkdir()
    (logs / "bad" / "log.csv").write_text("time,other\n" + "".join(f"{k / 50},{k}\n" for k in range(100)))


BAD = (
    bad_link, bad_loop, bad_pipe, bad_socket, bad_linked_log, bad_piped_log, bad_empty_log, bad_no_log, bad_other_file,
    bad_deep, bad_log_beside, bad_no_signal,
)  # fmt: skip


@pytest.mark.parametrize("bad", BAD, ids=lambda make: make.__name__.removeprefix("bad_"))
def test_a_bad_arrival_is_named_once_read_and_does_not_hold_up_the_others(
    lift: Watched, bad: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    lift.put("good")
    bad(lift.logs)
    found = lift.look()
    assert found.added == ("good",)
    ((name, why),) = found.left_out
    assert name.startswith("bad")
    assert "expected" in why
    monkeypatch.setattr(arrivals, "update", lambda *_: pytest.fail("it is read again"))
    assert lift.look() == Arrivals(left_out=found.left_out)


@pytest.mark.parametrize("name", ["new\nline", "\u202eright-to-left", "x" * 220, os.fsdecode(b"not-utf8-\xff"), "tab\t"])
def test_a_name_that_is_none_is_left_out(lift: Watched, name: str, tmp_path: Path) -> None:
    lift.put("good")
    lift.put(name, 101)
    found = lift.look()
    assert found.added == ("good",)
    assert len(found.left_out) == 1
    json.dumps([found.left_out, asdict(lift.seen)], ensure_ascii=False).encode()


def test_a_machine_or_a_recipe_in_a_recording_is_not_that_of_the_folder(lift: Watched) -> None:
    lift.put("a")
    (lift.logs / "a" / "machine.toml").write_text('schema = 1\nname = "another"\n')
    (lift.logs / "a" / "recipe.toml").write_text("what = ")
    lift.put("b", 101)
    assert set(lift.look().added) == {"a", "b"}


def test_a_mistake_in_the_recipe_of_the_folder_ends_the_call(lift: Watched) -> None:
    lift.put("a")
    (lift.logs / "recipe.toml").write_text("what = 1")
    with pytest.raises(SettingsError):
        lift.look()
    (lift.logs / "recipe.toml").write_text('schema = 1\n[recordings]\nmotion = ["other-*"]\n')
    assert [name for name, _ in lift.look().left_out] == ["a"]
    (lift.logs / "recipe.toml").unlink()  # a refusal holds for the recipe that it was made with
    assert lift.look().added == ("a",)


def test_what_vanishes_or_is_written_while_it_is_read(lift: Watched, monkeypatch: pytest.MonkeyPatch) -> None:
    for number, name in enumerate(("a", "b", "c")):
        lift.put(name, 100 + number)
    update = arrivals.update

    def disturbed(*arguments: Any) -> Any:
        shutil.rmtree(lift.logs / "a")
        lift.put("b", 101)
        return update(*arguments)

    lift.put("b", 101, 0.5)
    with monkeypatch.context() as patch:
        patch.setattr(arrivals, "update", disturbed)
        found = lift.look()
    assert (set(found.added), found.left_out, found.waiting) == ({"b", "c"}, (), ("a",))
    monkeypatch.setattr(arrivals, "update", lambda *words: looked.append(words[1]) or update(*words))
    looked: list[list[Path]] = []
    assert lift.look() == Arrivals()  # b is compared once more
    assert looked == [[lift.logs / "b"]]
    assert lift.rows == {"b": 400, "c": 400}


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
def test_an_unreadable_folder_or_file_is_left_out_until_it_can_be_read(lift: Watched) -> None:
    path = lift.put("a")
    lift.put("b", 101)
    for locked in (path, path.parent):
        locked.chmod(0)
        found = lift.look()
        assert [name for name, _ in found.left_out] == ["a"]
        locked.chmod(0o700)
    assert lift.look().added == ("a",)


def test_a_failing_disk_is_tried_again(lift: Watched, monkeypatch: pytest.MonkeyPatch) -> None:
    from sysid.datasets.versions import update

    lift.put("a")
    with monkeypatch.context() as patch:
        patch.setattr(update, "_read_through", lambda *_: (_ for _ in ()).throw(OSError(5, "Input/output error")))
        assert lift.look().left_out[0][0] == "a"
    assert lift.look().added == ("a",)


def test_two_folders_and_a_recording_that_is_in_both(lift: Watched, tmp_path: Path) -> None:
    other = tmp_path / "other"
    lift.put("a")
    shutil.copytree(lift.logs / "a", other / "b")
    write_log(other / "a" / "log.csv", 101)
    for _ in range(3):
        found, lift.seen = arrivals.take_in([lift.logs, other], lift.store, "lift-1", lift.fixed, 0.0, lift.seen)
        assert found.repeated == (("b", "a"),)
        assert [name for name, _ in found.left_out] == ["a"]  # of two folders, one name
    assert lift.rows == {"a": 400}
    assert len(lift.store.versions("lift-1")) == 2


# The state of the watch


def name_effects(location: str, reference: str, plant: str | None) -> FleetMachine:
    """The search for names is replaced by the hidden effect."""
    return FleetMachine(reference, "named", (DEADBAND,))


@pytest.fixture
def named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watching, "name_effects", name_effects)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_text(""),
    "no text": lambda path: path.write_bytes(b"\xff\xfe\x00"),
    "deep": lambda path: path.write_text("[" * 100_000 + "]" * 100_000),
    "a list": lambda path: path.write_text("[]"),
    "a number": lambda path: path.write_text("1"),
    "wrong types": lambda path: path.write_text(path.read_text().replace('"recordings": ', '"recordings": 1, "x": ', 1)),
    "newer": lambda path: path.write_text(path.read_text().replace('"schema": ', '"schema": 9', 1)),
    "cut": lambda path: path.write_text(path.read_text()[:-20]),
    "a pipe": lambda path: (path.unlink(), os.mkfifo(path)),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
    "a link": lambda path: (path.rename(path.with_suffix(".old")), path.symlink_to(path.with_suffix(".old"))),
    "a link to nothing": lambda path: (path.unlink(), path.symlink_to("nothing")),
}


def changed(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    values = json.loads(path.read_text())
    change(values)
    path.write_text(json.dumps(values))


IN_STATE: dict[str, Callable[[Path], object]] = {
    "not a number": lambda path: changed(path, lambda v: v["histories"][0]["values"].__setitem__(0, float("nan"))),
    "infinite": lambda path: changed(path, lambda v: v["recordings"][0].update(hours=1e999)),
    "no deviation": lambda path: changed(path, lambda v: v["histories"][0]["deviations"].__setitem__(0, 0.0)),
    "values missing": lambda path: changed(path, lambda v: v["histories"][0]["values"].pop()),
    "unknown recording": lambda path: changed(path, lambda v: v["histories"][0]["recordings"].__setitem__(0, "x")),
    "unknown parameter": lambda path: changed(path, lambda v: v["histories"][0].update(parameter="x")),
    "a recording twice": lambda path: changed(path, lambda v: v["recordings"].append(v["recordings"][0])),
    "no machine": lambda path: changed(path, lambda v: v.pop("machine")),
}


@pytest.mark.parametrize(
    ("file", "damage"),
    [
        *[pytest.param("watch", name, id=f"watch-{name}") for name in DAMAGES],
        *[pytest.param("arrivals", name, id=f"arrivals-{name}") for name in ("no text", "wrong types", "a folder")],
        *[pytest.param("watch", name, id=f"watch-{name}") for name in IN_STATE],
    ],
)
def test_a_damaged_state_is_an_error_whose_remedy_works(lift: Watched, named: None, file: str, damage: str) -> None:
    lift.put("bad", share=0.0)
    watch(lift.workspace, "lift-1", [lift.logs], quiet_s=0.0)
    path = lift.workspace / "fleet" / file / "lift-1.json"
    (DAMAGES | IN_STATE)[damage](path)
    with pytest.raises(StoreError) as error:
        watch(lift.workspace, "lift-1", [lift.logs], quiet_s=0.0)
    assert str(path.name) in error.value.where
    assert error.value.expected
    if "--restart" in error.value.remedy:
        assert watch(lift.workspace, "lift-1", [lift.logs], quiet_s=0.0, restart=True).new == ()
    else:
        assert error.value.remedy.startswith("Remove it")
        path.rmdir() if path.is_dir() else path.unlink()
        assert watch(lift.workspace, "lift-1", [lift.logs], quiet_s=0.0).new == ()


class Killed(BaseException):
    """In place of a signal that ends the process."""


def test_a_call_that_is_killed_at_any_write_is_continued(lift: Watched, named: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrivals, "BATCH", 1)
    monkeypatch.setattr(watching, "BATCH", 1)
    shutil.copytree(lift.workspace, lift.workspace.with_name("undisturbed"))
    for k, name in enumerate(("a", "b", "c")):
        lift.put(name, 100 + k)
    expected = watch(lift.workspace.with_name("undisturbed"), "lift-1", [lift.logs], quiet_s=0.0)

    def killed_at(write: int) -> bool:
        """Whether the call was killed before or after it wrote something for the ``write``-th time."""
        left = [write]

        def counted(before: Callable[..., Any]) -> Callable[..., Any]:
            def run(*arguments: Any, **named: Any) -> Any:
                left[0] -= 1
                if left[0] == 0:
                    raise Killed
                result = before(*arguments, **named)
                left[0] -= 1
                if left[0] == 0:
                    raise Killed
                return result

            return run

        with monkeypatch.context() as patch:
            patch.setattr(watching, "_keep", counted(watching._keep))
            patch.setattr(Store, "append", counted(Store.append))
            try:
                watch(lift.workspace, "lift-1", [lift.logs], quiet_s=0.0)
            except Killed:
                return True
        return False

    assert [killed_at(write) for write in (1, 2, 3, 4, 3, 5)].count(True) >= 5
    last = watch(lift.workspace, "lift-1", [lift.logs], quiet_s=0.0)
    state = [place / "fleet/watch/lift-1.json" for place in (lift.workspace, lift.workspace.with_name("undisturbed"))]
    assert state[0].read_text() == state[1].read_text()
    assert replace(last.fleet, seconds=0.0) == replace(expected.fleet, seconds=0.0)


def test_values_of_a_recording_that_is_replaced_are_those_of_the_new_one(
    lift: Watched, named: None, begun: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    lift.put("a", 101)
    lift.put("b", 102, 0.5)
    watch(lift.workspace, "lift-1", [lift.logs], quiet_s=0.0)
    lift.put("b", 102)
    lift.put("c", 100)  # earlier than both
    result = watch(lift.workspace, "lift-1", [lift.logs], quiet_s=0.0)
    assert set(result.new) == {"b", "c"}
    assert result.fleet.histories[0].recordings[-3:] == ("c", "a", "b")
    other = Watched(tmp_path_factory.mktemp("other"), begun)
    whole = watch(other.workspace, "lift-1", [lift.logs], quiet_s=0.0)
    assert result.fleet.histories == whole.fleet.histories
