"""Tables in memory as a dataset, as the guide has it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from crane_data import crane, motion

from sysid.datasets import Dataset
from sysid.errors import InputError
from sysid.gap import GapResult

PAGE = Path(__file__).parents[2] / "docs" / "guide" / "own-logs.md"


def test_recordings_keep_their_order_and_roles() -> None:
    runs = [motion(name, 2.0) for name in ("a", "b", "c")]
    dataset = Dataset.of(crane(), iter(runs), {"c": "held_out", "a": "fit"})
    assert (dataset.reference, dataset.recordings) == ("crane@1", tuple(runs))
    assert (dataset.with_role("fit"), dataset.with_role("held_out")) == ((runs[0],), (runs[2],))
    assert dataset.with_role("select") == ()


def test_a_role_of_nobody_and_a_name_of_two_are_refused() -> None:
    run = motion("run-1", 2.0)
    with pytest.raises(InputError, match="run-1"):
        Dataset.of(crane(), [run], {"run1": "fit"})
    with pytest.raises(InputError, match="2 named 'run-1'"):
        Dataset.of(crane(), [run, replace(run)])


def test_the_example_of_the_guide_runs(tmp_path: Path) -> None:
    import plant_data

    made = plant_data.dataset_of(plant_data.nominal(), 8.0)
    for name, text in made.machine.files().items():
        (tmp_path / name).write_text(text, "utf-8")
    days = ("monday", "tuesday", "wednesday", "thursday")
    names: dict[str, Any] = {
        "path": tmp_path / "machine.toml",
        "tables": {day: run.table for day, run in zip(days, made.recordings, strict=True)},
    }
    (example,) = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), flags=re.DOTALL)
    exec(compile(example, str(PAGE), "exec"), names)
    assert isinstance(names["result"], GapResult)
    assert names["result"].verdict == "no_gap"
