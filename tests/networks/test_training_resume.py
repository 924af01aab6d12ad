"""Training that is interrupted goes on from its checkpoints to the very same weights, and leaves nothing half-written."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from crane_data import dataset

from sysid.errors import SettingsError, StorageError, StoreError
from sysid.networks import (
    Checkpoints,
    EnsembleMember,
    TrainedMember,
    TrainingSettings,
    fit_actuator,
    fit_forward,
    member,
    parse_recipe,
    to_files,
    train,
)
from sysid.networks.member import State

SETTINGS = TrainingSettings(learning_rate=3e-3, batch=16, epochs=30, patience=30, check_every=3, schedule="cosine", threads=2)
HIDDEN = (24, 10)


def members() -> list[EnsembleMember]:
    rng = np.random.default_rng(0)
    x, v = rng.uniform(-1, 1, (130, 2)), rng.uniform(-1, 1, (40, 2))
    whole = EnsembleMember("whole", x, np.sin(3 * x[:, :1]) * x[:, 1:], v, np.sin(3 * v[:, :1]) * v[:, 1:], ("a", "b"), ("c",))
    part = replace(whole, name="part", inputs=x[:75], outputs=whole.outputs[:75], learning_rate=1e-3)
    return [whole, part, replace(whole, name="deep", hidden=(8, 8, 8)), replace(whole, name="again")]


def run(
    folder: Path | None, every: float = 1e9, progress: object = None, settings: TrainingSettings = SETTINGS
) -> tuple[TrainedMember, ...]:
    checkpoints = None if folder is None else Checkpoints(folder, every)
    return train(members(), HIDDEN, settings, 5, progress, checkpoints)  # type: ignore[arg-type]


def assert_same(found: tuple[TrainedMember, ...], wanted: tuple[TrainedMember, ...]) -> None:
    for one, other in zip(found, wanted, strict=True):
        for a, b in zip((*one.mlp.weights, *one.mlp.biases), (*other.mlp.weights, *other.mlp.biases), strict=True):
            np.testing.assert_array_equal(a, b)
        assert one.curve.to_json() == other.curve.to_json()


def interrupted(folder: Path, error: BaseException, at: float = 0.4) -> None:
    """Train until a share of the work is done, then be interrupted."""

    def tell(done: float, text: str) -> None:
        if done >= at:
            raise error

    with pytest.raises(type(error)):
        run(folder, 1e9, tell)


def test_checkpoints_change_nothing_and_go_when_it_is_done(tmp_path: Path) -> None:
    assert_same(run(tmp_path / "new", 0.02), run(None))
    assert not (tmp_path / "new").exists()


def test_an_interrupt_is_kept_however_often_it_comes(tmp_path: Path) -> None:
    folder = tmp_path / "training"
    for at in (0.2, 0.5, 0.8):
        interrupted(folder, KeyboardInterrupt(), at)
        assert {path.name.rsplit("-", 1)[0] for path in folder.iterdir()} <= {"whole", "part", "deep", "again"}
    begun: list[float] = []
    found = run(folder, 1e9, lambda done, _: begun.append(done), replace(SETTINGS, threads=1))
    assert_same(found, run(None))
    assert not folder.exists()


def test_resuming_does_not_start_over(tmp_path: Path) -> None:
    interrupted(tmp_path, KeyboardInterrupt(), 0.9)
    checks: list[float] = []
    run(tmp_path, 1e9, lambda done, _: checks.append(done))
    whole: list[float] = []
    run(None, 1e9, lambda done, _: whole.append(done))
    assert len(checks) < 0.6 * len(whole)


def test_sigterm_is_kept_too_and_its_handler_put_back(tmp_path: Path) -> None:
    def tell(done: float, _: str) -> None:
        if done > 0.4:
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(SystemExit, match="143"):
        run(tmp_path, 1e9, tell)
    assert list(tmp_path.glob("*.safetensors"))
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    assert_same(run(tmp_path), run(None))


def test_a_killed_process_is_resumed_to_the_same_bits(tmp_path: Path) -> None:
    """It writes at every update, so that the kill falls anywhere, also within a write."""
    program = f"from pathlib import Path; from test_training_resume import run; run(Path({str(tmp_path)!r}), 0.0)"
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    child = subprocess.Popen([sys.executable, "-c", program], env=os.environ | {"PYTHONPATH": path})
    until = time.monotonic() + 60.0
    while len(list(tmp_path.glob("*.safetensors"))) < 3 and child.poll() is None and time.monotonic() < until:
        time.sleep(0.005)
    child.kill()
    assert child.wait() == -signal.SIGKILL
    assert list(tmp_path.glob("*.safetensors"))
    assert_same(run(tmp_path), run(None))
    assert not list(tmp_path.glob("*"))


@pytest.mark.parametrize("change", [{"learning_rate": 2e-3}, {"batch": 8}])
def test_other_settings_do_not_find_it(tmp_path: Path, change: dict[str, object]) -> None:
    interrupted(tmp_path, KeyboardInterrupt())
    other = replace(SETTINGS, **change)  # type: ignore[arg-type]
    kept = set(tmp_path.iterdir())
    assert_same(run(tmp_path, settings=other), run(None, settings=other))
    used = {path.name.rsplit("-", 1)[0] for path in kept - set(tmp_path.iterdir())}
    assert used == ({"part"} if "learning_rate" in change else set())  # which has a learning rate of its own


def test_divergence_leaves_no_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"network .*: the loss became"):
        run(tmp_path / "new", settings=replace(SETTINGS, learning_rate=1e18))
    assert not (tmp_path / "new").exists()


def test_a_full_disk_says_so_and_the_checkpoint_before_stays_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    interrupted(tmp_path, KeyboardInterrupt())
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(
            StorageError, match=r"checkpoint .*safetensors: No space left on device; expected room for \d+ bytes. Make room"
        ):
            run(tmp_path, 0.0)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert_same(run(tmp_path), run(None))


@pytest.mark.parametrize("content", [b"", b"foreign", None])
def test_a_damaged_checkpoint_is_named(tmp_path: Path, content: bytes | None) -> None:
    interrupted(tmp_path, KeyboardInterrupt())
    path = sorted(tmp_path.iterdir())[0]
    path.write_bytes(path.read_bytes()[:-9] if content is None else content)
    with pytest.raises(StoreError, match=rf"checkpoint {path}: not readable .*Delete it"):
        run(tmp_path)


def test_a_fit_of_networks_goes_on_to_the_same_files(tmp_path: Path) -> None:
    settings = {"epochs": 10, "check_every": 1}
    recipe = parse_recipe(
        {
            "actuator": {"hidden_of": {"boom": [8, 8], "stick": [8]}, "training": settings},
            "forward": {"hidden": [16], "members": 2, "training": settings},
        },
        "test",
    )
    data = dataset()

    def tell(done: float, text: str) -> None:
        if 0.3 < done < 1.0:
            raise KeyboardInterrupt

    for fit in (fit_actuator, fit_forward):
        with pytest.raises(KeyboardInterrupt):
            fit(data, recipe, tell, Checkpoints(tmp_path / "training"))
        assert list((tmp_path / "training").glob("*.safetensors"))
        assert to_files(fit(data, recipe, None, Checkpoints(tmp_path / "training"))) == to_files(fit(data, recipe))
        assert not (tmp_path / "training").exists()


def test_a_checkpoint_is_written_where_another_training_removes_the_empty_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoints, other = Checkpoints(tmp_path / "training"), Checkpoints(tmp_path / "training")
    real, raced = member.write_durably, []

    def removed_once(path: Path, content: bytes, what: str, remedy: str) -> None:
        if not raced:
            raced.append(path)
            path.parent.mkdir()
            other.remove("other")
            raise StorageError("checkpoint", "No such file or directory", "room", remedy) from FileNotFoundError()
        real(path, content, what, remedy)

    monkeypatch.setattr(member, "write_durably", removed_once)
    state = State.at_start(np.ones(3, dtype=np.float32))
    checkpoints.save("one", state)
    found = checkpoints.load("one", 3)
    assert raced
    assert found is not None
    np.testing.assert_array_equal(found.row, state.row)
    other.remove("other")
    assert checkpoints.path("one").exists()
