"""The recipes of real machines on their measured files."""

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


@pytest.mark.parametrize(
    ("name", "folder", "count"),
    [
        ("xl330", "bam_xl330", 16),
        ("so101", "sage_so101", 8),
        ("hydraulic_actuator", "hyd_actuator", 2),
        ("double_pendulum", "double_pendulum", 5),
        ("servo_backlash", "servo_backlash", 5),
    ],
)
def test_checksums_of_the_other_machines(shared_data: Path, datasets_folder: Path, name: str, folder: str, count: int) -> None:
    listed = re.findall(
        r"`(\S+\.(?:mat|csv|json))` \|.*`([0-9a-f]{64})`", (datasets_folder / name / "README.md").read_text("utf-8")
    )
    assert len(listed) == count
    for file, digest in listed:
        assert hashlib.sha256((shared_data / folder / file).read_bytes()).hexdigest() == digest


def test_servos(shared_data: Path, datasets_folder: Path, tmp_path: Path) -> None:
    log = shared_data / "sage_so101/single_joint_elbow"
    arm = ingest(log, tmp_path, recipe=datasets_folder / "so101/recipe.toml")
    assert list(arm.splits.values()) == ["fit", "select", "held_out"]
    assert arm.units["elbow.command"] == "rad"
    elbow = np.concatenate([r.values("elbow.joint") for r in arm.recordings])
    counts = elbow[~np.isnan(elbow)] / (2.0 * np.pi / 4096) - 0.5  # zero lies between two counts
    assert np.median(np.abs(counts - np.round(counts))) < 0.05  # steps of the encoder, hardly interpolated
    pendulum = ingest(shared_data / "bam_xl330", tmp_path, recipe=datasets_folder / "xl330/recipe.toml")
    assert len(pendulum.recordings) == 12
    for recording in pendulum.recordings:
        assert len(recording) / 190.0 == pytest.approx(6.0, abs=0.1)
        assert np.nanmax(np.abs(recording.values("arm.joint"))) < np.nanmax(np.abs(recording.values("arm.command"))) + 0.25


def test_double_pendulum(shared_data: Path, datasets_folder: Path, tmp_path: Path) -> None:
    dataset = ingest(shared_data / "double_pendulum", tmp_path, recipe=datasets_folder / "double_pendulum/recipe.toml")
    roles = {"raise_and_drop": "fit", "sines_octave": "fit", "sines_same": "select", "compensated": "held_out"}
    assert dict(dataset.splits) == roles
    first = {r.name: r.values("elbow.joint")[0] for r in dataset.recordings}
    assert first == pytest.approx(
        {"sines_same": -0.007, "sines_octave": -0.046, "raise_and_drop": -0.076, "compensated": 0.142}, abs=1e-3
    )
    free = dataset.recording("raise_and_drop")
    half = len(free) // 2 + 50
    assert not free.values("shoulder.command")[half:].any(), "it swings by itself"
    assert np.ptp(free.values("shoulder.joint")[half:]) > 2.0


def test_servo_backlash(shared_data: Path, datasets_folder: Path, tmp_path: Path) -> None:
    for file in ("single", "comp2"):
        log, recipe = shared_data / f"servo_backlash/{file}.csv", datasets_folder / "servo_backlash/recipe.toml"
        values = np.concatenate([r.values("servo.joint") for r in ingest(log, tmp_path, recipe=recipe, name=file).recordings])
        counts = values[~np.isnan(values)] / (2.0 * np.pi / 4096)
        assert np.abs(counts).max() < 102.5
        assert np.median(np.abs(counts - np.round(counts))) < 1e-6


def test_a_benchmark_without_stamps(shared_data: Path, datasets_folder: Path, tmp_path: Path) -> None:
    arm = ingest(shared_data / "hyd_actuator", tmp_path, recipe=datasets_folder / "hydraulic_actuator/recipe.toml")
    assert list(arm.splits.values()) == ["fit", "select", "held_out"]
    assert np.nanmax(np.abs(np.concatenate([r.values("arm.command") for r in arm.recordings]))) < 1.0


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
