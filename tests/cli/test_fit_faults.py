"""``sysid fit`` and ``sysid validate`` on data and places that fail: what is said, and that nothing is half registered."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from crane_data import poses, replaced
from filelock import FileLock
from pose_workspace import QUICK, pose_workspace

from sysid.cli import main
from sysid.datasets.recording import Recording
from sysid.networks import StructuredForward
from sysid.registry import Registry
from sysid.workspace import Workspace

GEOMETRY = '[forward]\nmodel = "structured"\nresidual = false\n'


def gappy(recording: Recording, every: int) -> Recording:
    """The same with a joint missing in all rows but each ``every``-th."""
    values = recording.values("stick.joint").copy()
    values[np.arange(len(values)) % every != 0] = np.nan
    return replaced(recording, "stick.joint", values)


DATA: dict[str, Callable[[], Recording]] = {
    "good": lambda: poses(count=80),
    "some-missing": lambda: gappy(poses(count=160), 2),
    "most-missing": lambda: gappy(poses(count=160), 8),
    "few": lambda: poses(count=20),
    "constant": lambda: replaced(poses(count=80), "slew.joint", 0.3),
    "unmeasured": lambda: replaced(poses(count=80), "ee.y", np.nan),
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """A workspace with a dataset of each kind."""
    folder = tmp_path_factory.mktemp("faults")
    found = pose_workspace(folder, {name: recording() for name, recording in DATA.items()})
    (folder / "diverging.toml").write_text(QUICK + "learning_rate = 1e18\n")
    (folder / "long.toml").write_text(QUICK.replace("epochs = 4", "epochs = 60") + "check_every = 2\n")
    (folder / "geometry.toml").write_text(GEOMETRY)
    return found


def run(place: Workspace, *args: str) -> int:
    with pytest.raises(SystemExit) as stop:
        main(["--workspace", str(place.folder), *args])
    assert isinstance(stop.value.code, int)
    return stop.value.code


def fit(place: Workspace, name: str, recipe: str = "quick") -> int:
    return run(place, "fit", "forward", name, "--recipe", str(place.folder.parent / f"{recipe}.toml"))


@pytest.mark.parametrize(
    ("name", "recipe", "message"),
    [
        ("few", "quick", "16 static poses to fit; expected at least 30. Record the calibration routine"),
        ("most-missing", "quick", "16 static poses to fit; expected at least 30"),
        ("constant", "quick", "network forward: slew.joint is constant (0.3); expected a signal that varies"),
        ("unmeasured", "quick", "no poses recording to fit that measures ee.y"),
        ("good", "diverging", "network forward: the loss became"),
    ],
)
def test_what_cannot_be_fitted_is_said_and_nothing_is_registered(
    place: Workspace, name: str, recipe: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fit(place, name, recipe) == 2
    told = capsys.readouterr()
    assert message in " ".join(told.err.split())
    assert "Traceback" not in told.err
    assert not [version for version in place.models.list() if version.name == f"{name}-forward"]
    assert not list((place.folder / "training").glob("*")) if (place.folder / "training").exists() else True


def test_rows_with_gaps_are_left_out_and_the_rest_is_fitted(place: Workspace, capsys: pytest.CaptureFixture[str]) -> None:
    assert fit(place, "some-missing") == 0
    model = place.network("some-missing-forward")
    assert np.isfinite(model.predict(np.zeros((1, 4)))).all()  # type: ignore[union-attr]
    assert run(place, "validate", "some-missing-forward", "some-missing") == 0
    told = capsys.readouterr().out
    assert re.search(r"8\d.% intervals of ee\.x, poses: ± [\d.]+.mm, coverage \d+.%; [\d.]+.% flagged", told)


def test_a_joint_that_stands_still_leaves_its_geometry_open_and_says_where_it_was(place: Workspace) -> None:
    """The geometry needs no motion of every joint; what was not seen is outside the data."""
    assert fit(place, "constant", "geometry") == 0
    model = place.network("constant-forward")
    assert isinstance(model, StructuredForward)
    q = np.array([[0.3, 0.5, -1.2, 0.1], [1.0, 0.5, -1.2, 0.1]])
    assert model.inside(q).tolist() == [True, False]


def test_a_registry_that_is_held_is_waited_for_and_then_said(
    place: Workspace, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = place.models.list()
    monkeypatch.setattr(Workspace, "models", property(lambda self: Registry(self.folder, wait_s=0.2)))
    with FileLock(place.folder / "registry.lock"):
        assert fit(place, "good") == 2
    assert "in use by another process; expected a free registry. Try again" in " ".join(capsys.readouterr().err.split())
    assert place.models.list() == before
    assert fit(place, "good") == 0  # and once it is free


def test_an_interrupted_fit_goes_on_to_the_same_version(
    place: Workspace, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command that was stopped starts again where it was, and ends with the very version that it would have made."""

    @contextmanager
    def stopped(title: str) -> Iterator[Callable[[float, str], None]]:
        def report(done: float, text: str) -> None:
            if done > 0.3:
                raise KeyboardInterrupt

        yield report

    before = place.models.list()
    with monkeypatch.context() as patch:
        patch.setattr("sysid.front.place.progress_bar", stopped)
        assert fit(place, "good", "long") == 130
    assert "the command can be repeated" in capsys.readouterr().err
    assert place.models.list() == before
    assert list((place.folder / "training").glob("*.safetensors"))
    assert fit(place, "good", "long") == 0
    assert not (place.folder / "training").exists()
    resumed = place.models.list()
    assert len(resumed) == len(before) + 1
    assert fit(place, "good", "long") == 0  # from the beginning: the same content is the same version
    assert place.models.list() == resumed


def test_a_full_disk_is_said_and_leaves_what_was_there(
    place: Workspace, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = place.models.list()
    written = set((place.folder / "models").rglob("*"))

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        assert fit(place, "good", "geometry") == 1
    assert "No space left on device" in capsys.readouterr().err
    assert place.models.list() == before
    assert set((place.folder / "models").rglob("*")) == written


def test_a_model_that_was_changed_is_refused_before_it_is_read(place: Workspace, capsys: pytest.CaptureFixture[str]) -> None:
    assert fit(place, "good", "geometry") == 0
    version = next(v for v in place.models.list() if v.name == "good-forward" and "candidate" in v.aliases)
    path = place.folder / "models" / version.digest / "network.json"
    content = path.read_text()
    path.write_text(content.replace("slew", "slow"))
    assert run(place, "validate", version.reference, "good") == 2
    assert "so the content was changed after registration" in " ".join(capsys.readouterr().err.split())
    path.write_text(content)
