"""Backlash behind a noisy sensor on generated cranes: it is named, as wide as it is, and nothing else is."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

PIPELINES = Path(__file__).parents[2] / "pipelines"
SEED = 41


@pytest.fixture(scope="module")
def study() -> Iterator[ModuleType]:
    import importlib

    sys.path.insert(0, str(PIPELINES))
    try:
        yield importlib.import_module("noisy_backlash")
    finally:
        sys.path.remove(str(PIPELINES))


def test_cases_follow_from_the_seed_and_cover_the_range(study: ModuleType) -> None:
    cases = [study.case_of(number, SEED) for number in range(60)]
    assert cases == [study.case_of(number, SEED) for number in range(60)]
    assert cases[0] != study.case_of(0, SEED + 1)
    assert {case.axis for case in cases} == set(study.AXES)
    assert min(case.ratio for case in cases) < 2.5
    assert max(case.ratio for case in cases) > 15.0


def test_the_table_counts_names_widths_and_intervals(study: ModuleType) -> None:
    case = study.case_of(0, SEED)
    right = study.Answer(replace(case, ratio=3.0), 0.01, 0.0101, (0.009, 0.011), (), "named")
    wide = study.Answer(replace(case, ratio=5.0), 0.01, 0.012, (0.011, 0.013), (("sensor_bias", "boom.joint"),), "named")
    missed = study.Answer(replace(case, ratio=19.0), 0.01, None, None, (), "unnamed")
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in study.table_of([right, wide, missed]).splitlines()[2:]]
    assert rows[0] == ["2 to 4", "1", "1", "1.0, 1.0 %", "1", "1", "0"]
    assert rows[1] == ["4 to 8", "1", "1", "20.0, 20.0 %", "0", "0", "1"]
    assert rows[2][:3] == ["8 to 20", "1", "0"]
    assert rows[3][:3] == ["all", "3", "2"]


@pytest.mark.slow
@pytest.mark.parametrize("number", range(4))
def test_backlash_behind_a_noisy_wire_is_named_with_its_width(study: ModuleType, tmp_path: Path, number: int) -> None:
    answer = study.answered(study.case_of(number, SEED), tmp_path)
    assert answer.width is not None
    assert answer.holds or answer.error < study.CLOSE
    assert answer.others == ()
