"""The recipes of two real machines on their measured files."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest

from sysid.datasets import ingest


@pytest.mark.parametrize("name", ["emps", "rc_excavator"])
def test_the_files_are_those_the_readme_lists(shared_data: Path, datasets_folder: Path, name: str) -> None:
    listed = re.findall(r"`(\S+\.(?:mat|csv))` \|.*`([0-9a-f]{64})`", (datasets_folder / name / "README.md").read_text("utf-8"))
    assert {file for file, _ in listed} == {path.name for path in (shared_data / name).iterdir()}
    for file, digest in listed:
        assert hashlib.sha256((shared_data / name / file).read_bytes()).hexdigest() == digest


def test_emps(shared_data: Path, datasets_folder: Path, tmp_path: Path) -> None:
    from scipy.io import loadmat

    dataset = ingest(shared_data / "emps", tmp_path, recipe=datasets_folder / "emps/recipe.toml")
    assert dict(dataset.splits) == {"identify#1": "fit", "identify#2": "select", "pulses": "held_out"}
    assert dict(dataset.units) == {"time": "s", "slide.command": "N", "slide.joint": "m"}
    raw = loadmat(shared_data / "emps/DATA_EMPS_PULSES.mat")
    pulses = dataset.recording("pulses")
    assert len(pulses) == 24841
    np.testing.assert_array_equal(pulses.values("slide.command"), 35.15 * raw["vir"].ravel())
    # The stamps are k/1000 s but for 0.02 µs: nothing is shifted by a sample, nothing smoothed.
    np.testing.assert_allclose(pulses.values("slide.joint"), raw["qm"].ravel(), atol=2e-8)


def test_rc_excavator(shared_data: Path, datasets_folder: Path, tmp_path: Path) -> None:
    dataset = ingest(shared_data / "rc_excavator", tmp_path, recipe=datasets_folder / "rc_excavator/recipe.toml")
    assert [dataset.splits[f"manual#{k}"] for k in range(1, 6)] == ["fit", "select", "fit", "select", "held_out"]
    assert all(dataset.splits[r.name] == "held_out" for r in dataset.recordings if r.name.startswith("steps-"))
    whole = sum(len(r) for r in dataset.recordings if r.name.startswith("manual")) / 50.0
    assert len(dataset.recording("manual#5")) / 50.0 == pytest.approx(whole / 3, abs=3)
    for recording in dataset.recordings:
        for axis in dataset.machine.axes:
            assert np.nanmax(np.abs(recording.values(f"{axis.name}.command"))) < 1.001
            low, high = axis.range
            assert low < np.nanmin(recording.values(axis.driven)) < np.nanmax(recording.values(axis.driven)) < high
    # The pause of a second between the two directions of a step file is a gap, for the command as well.
    steps = dataset.recording("steps-boom-1")
    gap = np.isnan(steps.values("boom.cylinder"))
    assert 0.9 < gap.sum() / 50.0 < 1.1
    assert np.isnan(steps.values("boom.command")[gap]).mean() > 0.7
    assert np.nanmax(steps.values("boom.command")) == pytest.approx(1.0, abs=1e-3)
