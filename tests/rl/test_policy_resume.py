"""Training that is interrupted, killed or out of disk goes on from its last checkpoint to the very same bits."""

from __future__ import annotations

import errno
import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from test_ddpg import SEEN, assert_same
from training_case import recipe, steps, trainer

from sysid.errors import SettingsError, StorageError, StoreError
from sysid_rl.train import replay as replay_module
from sysid_rl.train.checkpoint import STATE, TrainingFiles, training_folder
from sysid_rl.train.ddpg import Trainer
from sysid_rl.train.recipe import TrainingRecipe
from sysid_rl.train.replay import Replay


def short(**parts: Any) -> TrainingRecipe:
    """105 steps of four copies, in which the buffer comes round."""
    return recipe(**{"learning": {"episodes": 28}, **parts})


def run(folder: Path | None, settings: TrainingRecipe, until: int | None = None, always: bool = False) -> Trainer:
    """Train, from what ``folder`` holds, to the end or for ``until`` steps; saved then, or ``always``: after each step."""
    each = trainer(settings)
    files = TrainingFiles(folder, 0.0) if folder is not None else None
    if files is not None:
        files.load(each)
    for step_count in each.train():
        if files is not None and (always or step_count == until):
            files.save(each)
        if step_count == until:
            break
    return each


@pytest.fixture(scope="module")
def whole() -> Trainer:
    """The training of :func:`short` without an interruption."""
    return run(None, short())


def assert_equal(one: Trainer, other: Trainer) -> None:
    for key in SEEN:
        assert_same(one.state()[key], other.state()[key])
    assert one.replay.count == other.replay.count
    assert torch.equal(one.replay.rows, other.replay.rows)


@pytest.fixture(autouse=True)
def _short_segments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay_module, "SEGMENT", 64)


def test_going_on_anywhere_gives_the_same_bits(tmp_path: Path, whole: Trainer) -> None:
    """Also in the middle of an episode, before the first update, and after the buffer has come round."""
    for until in (3, 22, 61, 90):
        assert run(tmp_path, short(), until=until).step_count == until
    assert_equal(run(tmp_path, short()), whole)
    assert whole.replay.count == 420 > whole.replay.capacity


def test_a_curriculum_goes_on_where_it_was(tmp_path: Path) -> None:
    settings = short(setting={"curriculum": 0.7})
    assert run(tmp_path, settings, until=61).step_count == 61
    assert_equal(run(tmp_path, settings), run(None, settings))


def test_saving_changes_nothing(tmp_path: Path, whole: Trainer) -> None:
    assert_equal(run(tmp_path, short(), always=True), whole)


def test_a_killed_process_is_resumed_to_the_same_bits(tmp_path: Path, whole: Trainer) -> None:
    """It writes at every step, so that the kill falls anywhere, also within a write; twice, at different places."""
    settings = short()
    for least in (10, 45):
        child = os.fork()
        if child == 0:  # pragma: no cover  (another process)
            run(tmp_path, settings, always=True)
            os._exit(0)
        until = time.monotonic() + 60.0
        while time.monotonic() < until and _rows(tmp_path) < 4 * least * 4:
            time.sleep(0.001)
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        assert os.WIFSIGNALED(status)
        assert (tmp_path / STATE).exists()
    begun = trainer(settings)
    TrainingFiles(tmp_path).load(begun)
    assert 40 <= begun.step_count < begun.recipe.total_steps
    assert_equal(run(tmp_path, settings), whole)


def _rows(folder: Path) -> int:
    """Bytes of a column of all segments that were ever written."""
    numbers = [int(path.stem.partition("-")[2]) for path in folder.glob("replay-*.f32")]
    return (max(numbers) * 64 * 4 + (folder / f"replay-{max(numbers):06d}.f32").stat().st_size // 25) if numbers else 0


def test_a_full_disk_stops_it_and_the_checkpoint_before_stays_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: Trainer
) -> None:
    settings = short()
    run(tmp_path, settings, until=40)
    before = (tmp_path / STATE).read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for what in ("replay buffer in", "checkpoint"):
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", full)
            if what == "checkpoint":
                patch.setattr(Replay, "save", lambda self, folder: None)
            with pytest.raises(StorageError, match=rf"{what} .*No space left on device; expected room for \d+ .*Make room"):
                run(tmp_path, settings, always=True)
        assert (tmp_path / STATE).read_bytes() == before
        assert not list(tmp_path.glob("*.part"))
    assert_equal(run(tmp_path, settings), whole)


def test_no_number_is_never_saved(tmp_path: Path, whole: Trainer) -> None:
    settings = short()
    each = run(tmp_path, settings, until=40)
    before = (tmp_path / STATE).read_bytes()
    each.agent.models["actor"].parameters.flat[0] = float("inf")
    with pytest.raises(SettingsError, match="NaN or infinity"):
        TrainingFiles(tmp_path).save(each)
    assert (tmp_path / STATE).read_bytes() == before
    assert_equal(run(tmp_path, settings), whole)


@pytest.mark.parametrize("content", [b"", b"foreign", None])
def test_a_damaged_checkpoint_is_named(tmp_path: Path, content: bytes | None) -> None:
    run(tmp_path, recipe(), until=20)
    path = tmp_path / STATE
    path.write_bytes(path.read_bytes()[:-9] if content is None else content)
    with pytest.raises(StoreError, match=rf"checkpoint {path}: not readable .*Delete"):
        run(tmp_path, recipe())


def test_rows_that_are_missing_are_named(tmp_path: Path) -> None:
    run(tmp_path, recipe(), until=20)
    (tmp_path / "replay-000001.f32").unlink()
    with pytest.raises(StoreError, match=r"replay buffer .*replay-000001.f32: 0 bytes from row 64; expected \d+. Delete"):
        run(tmp_path, recipe())


def test_old_segments_go_and_those_in_use_stay(tmp_path: Path) -> None:
    run(tmp_path, short(), until=50)
    each = run(tmp_path, short(), until=105)
    first = (each.replay.count - each.replay.capacity) // 64
    names = sorted(path.name for path in tmp_path.glob("replay-*.f32"))
    assert names == [f"replay-{number:06d}.f32" for number in range(first, -(-each.replay.count // 64))]


def test_newer_rows_leave_those_of_the_last_checkpoint_alone(tmp_path: Path, whole: Trainer) -> None:
    """A process may die after it wrote rows and before it wrote the checkpoint that counts them."""
    settings = short()
    each = run(tmp_path, settings, until=60)
    steps(each, 30)
    each.replay.save(tmp_path)
    assert_equal(run(tmp_path, settings), whole)


def test_the_buffer_keeps_the_newest() -> None:
    table = Replay(10, 2, 1)
    for begin in range(0, 28, 4):
        rows = np.arange(begin, begin + 4.0)
        table.add(np.stack([rows, -rows], axis=1), rows[:, None], rows, np.zeros((4, 2)))
    assert (len(table), table.count) == (10, 28)
    assert sorted(table.rows[:, 0].tolist()) == list(range(18, 28))
    drawn = table.take(table.draw(2000, np.random.default_rng(0)), torch.empty(2000, table.width))
    assert set(drawn[:, 0].tolist()) == set(range(18, 28))
    torch.testing.assert_close(drawn[:, 1], -drawn[:, 0])


def test_what_decides_the_result_is_in_the_name(tmp_path: Path) -> None:
    names = {
        training_folder(tmp_path, settings, origin).name
        for settings, origin in (
            (recipe(), {"plant": "a"}),
            (recipe(), {"plant": "b"}),
            (recipe(seed=1), {"plant": "a"}),
            (recipe(learning={"tau": 0.02}), {"plant": "a"}),
        )
    }
    assert len(names) == 4
    assert {name.rpartition("-")[0] for name in names} == {"small-seed0", "small-seed1"}


def test_the_full_path_goes_on_to_the_same_bits_too(tmp_path: Path) -> None:
    """In the middle of an episode, with commands under way; candidates evaluated by the plant itself."""
    setting = {"copies": 2, "full": True, "feedback": "plant", "task": {"steps": 9}}
    settings = recipe(setting=setting, learning={"episodes": 4, "start": 16}, evaluations=1)
    whole = run(None, settings)
    assert run(tmp_path, settings, until=13).step_count == 13
    assert_equal(run(tmp_path, settings), whole)
    assert whole.environment.observations > 10
    assert whole.agent.updates > 0
