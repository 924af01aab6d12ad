"""`sysid start` on generated machines: what is drafted is right, the rest is asked, and next to nothing is wrong in silence."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

PIPELINES = Path(__file__).parents[2] / "pipelines"
#: Seeds of the fast tier, and of the published table.
FEW, MANY = (301,), range(2000, 2100)
#: Least share of values that are right as drafted, largest share that is wrong in silence; most questions a machine.
RIGHT, WRONG, QUESTIONS = 0.95, 0.005, 5


@pytest.fixture(scope="module")
def study() -> Iterator[ModuleType]:
    import importlib

    sys.path.insert(0, str(PIPELINES))
    try:
        yield importlib.import_module("drafted_values")
    finally:
        sys.path.remove(str(PIPELINES))


@pytest.mark.parametrize("seed", FEW)
def test_what_is_drafted_is_right_or_asked(study: ModuleType, tmp_path: Path, seed: int) -> None:
    result = study.result_of(seed, tmp_path)
    wrong = {key: text for key, (state, text) in result.values.items() if state == "wrong"}
    assert not wrong
    assert Counter(state for state, _ in result.values.values())["right"] > 0.8 * len(result.values)
    assert len(result.questions) <= QUESTIONS


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_the_published_shares_hold(study: ModuleType, tmp_path: Path) -> None:
    results = [study.result_of(seed, tmp_path / str(seed)) for seed in MANY]
    whole: Counter[str] = sum(study.counted(results).values(), Counter())
    assert whole["right"] >= RIGHT * whole.total(), whole
    assert whole["wrong"] <= WRONG * whole.total(), study.tables(results, "")
    assert max(len(result.questions) for result in results) <= QUESTIONS


def test_a_wrong_value_is_seen(study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The comparison finds a gain that is 3 % off and a neutral that is 2 % of the range off."""
    describe = study.describe

    def skewed(*arguments: object, **options: object) -> object:
        from dataclasses import replace

        found = describe(*arguments, **options)
        lines = [_off(line) for line in found.machine.splitlines()]
        return replace(found, machine="\n".join(lines) + "\n")

    seed = 427  # one valve
    monkeypatch.setattr(study, "describe", skewed)
    values = study.result_of(seed, tmp_path).values
    assert all(state == "wrong" for (value, _), (state, _) in values.items() if value in ("gain", "rate"))
    assert any(value == "gain" for value, _ in values)


def _off(line: str) -> str:
    if line.startswith("gain = "):
        return f"gain = {1.03 * float(line.split()[2])}"
    return f"rate_hz = {1.02 * float(line.split()[2])}" if line.startswith("rate_hz = ") else line


@pytest.mark.parametrize("seed", range(3))
def test_the_logs_are_those_of_the_machine(study: ModuleType, tmp_path: Path, seed: int) -> None:
    """Every axis moves, its columns are in the logs, and a valve's steady speed is that of its parameters."""
    machine = study.generate(tmp_path / "logs", seed)
    text = {path: path.read_text("utf-8").splitlines()[0] for path in (tmp_path / "logs").rglob("*.csv")}
    for axis in machine.axes:
        low, high = machine.ends[axis.name]
        assert high > low
        assert not text or any(axis.command in header for header in text.values())
        if axis.kind == "valve":
            full = axis.zero + axis.turns * axis.span
            assert axis.speed_at(axis.zero) == 0.0
            assert axis.speed_at(full) == pytest.approx(axis.gain * (1.0 - axis.dead))
            assert np.sign(axis.speed_at(2.0 * axis.zero - full)) == -1.0
