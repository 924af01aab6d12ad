"""Positions that wrap are found, unwrapped and put into the range of their axis; other large steps are left as they are."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from command_line import run
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid.datasets import Dataset, Recording, ingest
from sysid.datasets.checks.run import check_plausibility
from sysid.datasets.wrapping import find_wraps, open_gaps, unwrapped, wraps_of
from sysid.errors import InputError
from sysid.machine import load_machine

Array = npt.NDArray[np.float64]
MODULI = (2.0 * math.pi, 360.0, 1.0, 256.0, 4096.0, 65536.0)
MACHINE = """\
schema = 1
name = "x"
rate_hz = 50.0

[[axes]]
name = "j1"
actuation = "position"
drives = "joint"
joint_type = "revolute"
"""
RECIPE = """\
schema = 1
name = "x"
machine = "machine.toml"
logs = "logs"

[[streams]]
files = "*.csv"
time = "time"

[streams.signals]
"j1.command" = {{ field = "command", unit = "rad" }}
"j1.joint" = {{ field = "joint", {joint} }}
"""


def wrap(position: Array, modulus: float, end: float) -> Array:
    """``position`` as a sensor reports it that wraps at ``end``."""
    return np.asarray((position - end) % modulus + end - modulus)


def swing(seed: int, rate: float = 100.0, seconds: float = 20.0) -> tuple[Array, Array]:
    """Times, and a smooth motion of unit peak speed."""
    random = np.random.default_rng(seed)
    times = np.arange(round(rate * seconds)) / rate
    frequencies, phases = random.uniform(0.05, 1.0, 3), random.uniform(0.0, 6.3, 3)
    speed = np.sin(2.0 * np.pi * frequencies * times[:, None] + phases).sum(axis=1)
    return times, np.cumsum(speed / np.abs(speed).max()) / rate


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    modulus=st.sampled_from(MODULI),
    phase=st.floats(0.0, 1.0),
    speed=st.floats(0.5, 20.0),
    gap=st.integers(0, 20),
    step=st.sampled_from([0.0, 1.0 / 4096.0]),
)
def test_a_wrapped_motion_is_restored(seed: int, modulus: float, phase: float, speed: float, gap: int, step: float) -> None:
    """Of up to a fifth of the modulus between two samples, with noise, missing rows and the resolution of a sensor."""
    times, motion = swing(seed)
    true = modulus * (speed * motion + phase)
    true += 1e-4 * modulus * np.random.default_rng(seed).normal(size=len(true))
    if step:
        true = np.round(true / (step * modulus)) * step * modulus
    seen = wrap(true, modulus, 0.5 * modulus)
    missing = np.random.default_rng(seed + 1).random(len(true)) < 0.02
    keep = np.ones(len(true), dtype=bool)
    keep[700 : 700 + (gap if speed * gap < 20.0 else 0)] = False  # less than a fifth of a turn
    times, true, seen = times[keep], true[keep], np.where(missing, np.nan, seen)[keep]
    found = wraps_of(times, seen, MODULI)
    crossed = np.abs(np.diff(seen[~np.isnan(seen)])) > 0.75 * modulus
    if not crossed[8:-8].any():
        return
    assert found is not None
    assert found.modulus == modulus
    back = unwrapped(times, seen, modulus)
    there = ~np.isnan(seen)
    assert np.ptp(back[there] - true[there]) < 1e-6 * modulus


def test_a_wrong_number_of_turns_in_a_gap_is_known_to_be_open() -> None:
    """Over gaps of up to a fifth of the log: nearly all wrong ones; of those decided by the motion beside them, nearly none."""
    wrong = counted = short = needless = 0
    for seed in range(300):
        random = np.random.default_rng(seed)
        modulus, speed, gap = float(random.choice(MODULI)), random.uniform(0.5, 20.0), int(10.0 ** random.uniform(0.0, 2.6))
        times, motion = swing(seed)
        true = modulus * (speed * motion + 1e-4 * random.normal(size=len(motion)))
        keep = np.ones(len(true), dtype=bool)
        begin = int(random.integers(200, len(true) - gap - 200))
        keep[begin : begin + gap] = False
        if seed % 2:
            keep &= random.random(len(true)) > 0.02
        back = unwrapped(times[keep], wrap(true, modulus, 0.5 * modulus)[keep], modulus)
        jumps = np.flatnonzero(np.abs(np.diff(back - true[keep])) > 0.5 * modulus)
        found = open_gaps(times[keep], back, modulus)
        wrong, counted = wrong + len(jumps), counted + len(np.intersect1d(jumps, found))
        if speed * gap < 20.0:  # a fifth of a turn
            short, needless = short + 1, needless + len(found)
    assert wrong > 50
    assert counted >= 0.97 * wrong
    assert short > 5
    assert needless == 0


@pytest.mark.parametrize("stated", [False, True])
@pytest.mark.parametrize("late", [False, True])
def test_what_lies_beyond_an_open_gap_is_missing_and_counted(tmp_path: Path, stated: bool, late: bool) -> None:
    """The longest part stays, whichever comes first; what the others have is counted with the reason, and said."""
    times = np.arange(3000) / 50.0
    true = 8.0 * np.sin(0.7 * times) + 2.0 * np.sin(1.9 * times)
    gap = slice(900, 1200) if late else slice(1800, 2100)
    keep = np.ones(len(times), dtype=bool)
    keep[gap] = False
    (tmp_path / "logs/r0").mkdir(parents=True)
    joint = wrap(true, 2.0 * math.pi, math.pi)
    frame = pd.DataFrame({"time": times, "j1.command": np.sign(np.sin(times)), "j1.joint": np.where(keep, joint, np.nan)})
    frame.to_csv(tmp_path / "logs/r0/log.csv", index=False)
    (tmp_path / "machine.toml").write_text(MACHINE, encoding="utf-8")
    if stated:
        (tmp_path / "logs/recipe.toml").write_text(
            'schema = 1\n[[streams]]\nfiles = "*.csv"\n[streams.signals]\n"j1.command" = { field = "j1.command" }\n'
            '"j1.joint" = { field = "j1.joint", unit = "rad", modulus = 6.283185307179586 }\n',
            encoding="utf-8",
        )
    dataset = ingest(tmp_path / "logs", tmp_path / "ws", machine=tmp_path / "machine.toml")
    left = 900
    (source,) = dataset.sources
    (said,) = (text for text in source.losses if "several numbers of turns" in text)
    assert f"the gap of 6.02 s after {17.98 if late else 35.98} s: {left} samples" in said
    (figures,) = (own for key, own in dataset.quality["streams"]["r0"].items() if key.endswith("/j1.joint"))
    assert (figures["turns"], figures["empty"]) == (left, 300)
    values = np.concatenate([recording.values("j1.joint") for recording in dataset.recordings])
    assert np.count_nonzero(~np.isnan(values)) <= 1800 + 2
    assert any(finding.keys == ("j1.joint:samples",) for finding in check_plausibility(dataset))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), modulus=st.sampled_from(MODULI), reach=st.floats(0.2, 3.0), rate=st.floats(0.5, 30.0))
def test_a_fast_motion_does_not_wrap(seed: int, modulus: float, reach: float, rate: float) -> None:
    """A real motion of any size, also with two samples a period."""
    times = np.arange(2000) / 100.0
    random = np.random.default_rng(seed)
    true = reach * modulus * np.sin(2.0 * np.pi * rate * times + random.uniform(0.0, 6.3))
    assert find_wraps(times, true + 1e-4 * modulus * random.normal(size=len(times)), modulus) is None


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), modulus=st.sampled_from(MODULI), size=st.floats(0.3, 3.0), steps=st.integers(1, 6))
def test_a_reset_or_a_slip_is_no_wrap(seed: int, modulus: float, size: float, steps: int) -> None:
    """A step that is no multiple of the modulus: the encoder was set, or slipped."""
    times, motion = swing(seed)
    true = 0.05 * modulus * motion
    for row in np.random.default_rng(seed).integers(100, len(true) - 100, steps):
        true[row:] += size * modulus * (-1.0) ** int(row)
    left = abs(size - round(size))
    assert left < 0.02 or find_wraps(times, true, modulus) is None


@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_demanded_steps_of_one_turn_are_no_wraps(noise: float) -> None:
    """A square wave between −π and π, and single steps between two places."""
    times = np.arange(2000) / 100.0
    square = np.pi * np.sign(np.sin(2.0 * np.pi * 0.4 * times + 0.1)) * (1.0 - 1e-2 * (noise > 0.0))
    square += noise * np.random.default_rng(0).normal(size=len(times))
    assert find_wraps(times, square, 2.0 * np.pi) is None
    assert find_wraps(times, np.where(times > 7.0, 3.0, -3.0), 2.0 * np.pi) is None


def test_noise_at_an_end_is_unwrapped() -> None:
    times = np.arange(2000) / 100.0
    true = math.pi + 1e-3 * np.random.default_rng(0).normal(size=len(times))
    seen = wrap(true, 2.0 * math.pi, math.pi)
    assert find_wraps(times, seen, 2.0 * math.pi) is not None
    assert np.ptp(unwrapped(times, seen, 2.0 * math.pi) - true) < 1e-9


def logs(folder: Path, see: str, offset: float = 0.0, turns: float = 0.4) -> tuple[Path, list[Array]]:
    """Three recordings of a joint that crosses π, and its true angles; ``see``: columns as canonical names, or a recipe."""
    true = []
    for number in range(3):
        times = np.arange(800) / 50.0
        command = 2.9 + offset + turns * np.sin(2.0 * np.pi * 0.4 * times + 1.0 + number)
        joint = np.concatenate([command[:1], command[:1], command[:-2]])
        joint += 2e-4 * np.random.default_rng(number).normal(size=len(joint))
        true.append(joint)
        names = ("j1.command", "j1.joint") if see == "canonical" else ("command", "joint")
        seen = wrap(joint, 2.0 * math.pi, math.pi)
        place = folder / f"logs/r{number}"
        place.mkdir(parents=True)
        if see == "counts":
            seen = np.round((seen + math.pi) / (2.0 * math.pi) * 65536.0) % 65536.0
        pd.DataFrame({"time": times, names[0]: command, names[1]: seen}).to_csv(place / "log.csv", index=False)
    (folder / "machine.toml").write_text(MACHINE, encoding="utf-8")
    return folder, true


def recipe(folder: Path, joint: str) -> Path:
    (folder / "recipe.toml").write_text(RECIPE.format(joint=joint), encoding="utf-8")
    return folder


@pytest.mark.parametrize("see", ["canonical", "recipe", "counts"])
def test_ingest_unwraps_and_says_so(tmp_path: Path, see: str) -> None:
    """Without a recipe, and as an angle or as counts in one; a joint without limits stays near its command."""
    folder, true = logs(tmp_path, see, offset=6.0 * math.pi)
    if see == "recipe":
        recipe(folder, 'unit = "rad"')
    if see == "counts":
        recipe(folder, f'unit = "turn", span = 65536, offset = {-math.pi}')
    dataset = ingest(folder / "logs" if see == "canonical" else folder, tmp_path / "ws", machine=folder / "machine.toml")
    for recording, joint in zip(dataset.recordings, true, strict=True):
        assert np.abs(recording.values("j1.joint") - joint[: len(recording)]).max() < 1e-3
    texts = [text for source in dataset.sources for text in source.losses]
    assert len(texts) == 3
    assert all(text.startswith("j1.joint wraps at 3.14") and "by 6.283 rad: unwrapped" in text for text in texts)
    assert check_plausibility(dataset) == ()


def test_limits_choose_the_turn(tmp_path: Path) -> None:
    folder, true = logs(tmp_path, "canonical")
    limited = MACHINE.replace('joint_type = "revolute"', 'joint_type = "revolute"\nlimits = [-5.0, -1.0]')
    (folder / "machine.toml").write_text(limited, encoding="utf-8")
    dataset = ingest(folder / "logs", tmp_path / "ws", machine=folder / "machine.toml")
    shifts = [np.median(r.values("j1.joint") - q[: len(r)]) for r, q in zip(dataset.recordings, true, strict=True)]
    assert shifts == pytest.approx([-2.0 * math.pi] * 3, abs=1e-3)


def test_kept_wraps_are_the_only_finding(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is said about unit or sign of an axis with a position that wraps; the remedy that is named works."""
    folder, _ = logs(tmp_path, "recipe")
    recipe(folder, 'unit = "rad", modulus = 0')
    dataset = ingest(folder, tmp_path / "ws")
    (finding,) = check_plausibility(dataset)
    assert (finding.keys, finding.severity) == (("j1.joint:wrap",), "severe")
    assert finding.evidence[0].found.startswith("j1.joint wraps at 3.14")
    assert "`modulus = 0`" in finding.causes[0].remedy
    assert run("--workspace", tmp_path / "ws", "gap", "x") == 2
    assert "--accept 'j1.joint:wrap'" in capsys.readouterr().err
    recipe(folder, 'unit = "rad"')
    assert check_plausibility(ingest(folder, tmp_path / "ws")) == ()


def test_wraps_are_found_in_tables_that_were_resampled(tmp_path: Path) -> None:
    """A version of an earlier release: a row lies in the middle of a step."""
    folder, true = logs(tmp_path, "canonical")
    fine = np.arange(798) + 0.3
    tables = []
    for number, joint in enumerate(true):
        seen = np.interp(fine, np.arange(800), wrap(joint, 2.0 * math.pi, math.pi))
        command = np.interp(fine, np.arange(800), joint)
        tables.append(
            Recording(f"r{number}", pd.DataFrame({"time": fine / 50.0, "j1.command": command, "j1.joint": seen}), 50.0)
        )
    dataset = Dataset.of(load_machine(folder / "machine.toml"), tables)
    assert [finding.keys for finding in check_plausibility(dataset)] == [("j1.joint:wrap",)]
    right = [replace(r, table=r.table.assign(**{"j1.joint": r.table["j1.command"]})) for r in tables]
    assert check_plausibility(Dataset.of(dataset.machine, right)) == ()


def test_a_stated_modulus_is_used_and_checked(tmp_path: Path) -> None:
    folder, true = logs(tmp_path, "recipe")
    recipe(folder, 'unit = "rad", modulus = 6.283185307179586')
    dataset = ingest(folder, tmp_path / "ws")
    assert np.abs(dataset.recordings[0].values("j1.joint") - true[0][: len(dataset.recordings[0])]).max() < 1e-3
    assert [text for source in dataset.sources for text in source.losses] == []
    recipe(folder, 'unit = "rad", modulus = 3.0')
    with pytest.raises(
        InputError, match=r"values over a range of 6\.28\d* with `modulus = 3`; expected a range of one modulus"
    ):
        ingest(folder, tmp_path / "ws")
