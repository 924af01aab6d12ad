"""A result that is filed comes back as it was."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from sample_crane import sample_gap, sample_unnamed

from sysid.datasets.recording import Dataset
from sysid.errors import StoreError
from sysid.gap.result import Check, EffectEvidence, Promotion, WorldGap
from sysid.gap.stored_result import load_gap, save_gap


def test_round_trip(crane: Dataset, tmp_path: Path) -> None:
    plain = sample_gap(crane)
    checks = (Check("free run", "failed", "further off than before: stick.joint"), Check("world", "left out", "not run"))
    result = replace(
        plain,
        effects=(
            *(replace(effect, evidence=EffectEvidence(6614.0, 2312.0, 0.001, 11.5)) for effect in plain.effects[:-1]),
            replace(plain.effects[-1], undetermined=("damping_ratio",)),
        ),
        world_gap=WorldGap(plain.gap, plain.stage_gap, ("manual-04",), 2.9, "1 more recordings than 600 s"),
        machine_diff="--- machine.toml\n+++ machine.toml\n",
        promotion=Promotion("autolog@2", "autolog@1", "autolog@1", checks, checks[0].text),
    )
    path = save_gap(tmp_path / "gap", result)
    assert path.with_name("machine.diff").read_text() == result.machine_diff
    again = load_gap(tmp_path / "gap")
    assert again is not None
    assert replace(again, traces=()) == replace(result, traces=())
    for part in ("measured", "before", "after"):
        pd.testing.assert_frame_equal(getattr(again.traces[0], part), getattr(result.traces[0], part), check_like=True)


def test_numbers_that_json_lacks_survive(crane: Dataset, tmp_path: Path) -> None:
    result = sample_unnamed(crane)
    lost = replace(result.candidates[0], delta_bic=math.nan)
    save_gap(tmp_path / "gap", replace(result, candidates=(lost,), traces=()))
    again = load_gap(tmp_path / "gap")
    assert again is not None
    assert math.isnan(again.candidates[0].delta_bic)
    assert again.ambiguous == result.ambiguous
    assert again.traces == ()


@pytest.mark.parametrize("name", ["result.json", "traces.parquet", "machine.diff"])
def test_a_result_that_was_changed_by_hand_is_refused(crane: Dataset, tmp_path: Path, name: str) -> None:
    save_gap(tmp_path / "gap", sample_gap(crane))
    path = tmp_path / "gap" / name
    content = path.read_bytes()
    path.write_bytes(content.replace(b"0.", b"1.", 1) + b" ")
    with pytest.raises(StoreError, match=rf"{name}: changed after it was written; expected sha256 .*Run `sysid gap` again"):
        load_gap(tmp_path / "gap")
    path.unlink()
    if name != "result.json":
        with pytest.raises(StoreError, match=f"{name}: the file is missing"):
            load_gap(tmp_path / "gap")
    path.write_bytes(content)
    assert load_gap(tmp_path / "gap") is not None
    save_gap(tmp_path / "gap", sample_unnamed(crane))
    assert load_gap(tmp_path / "gap").effects == sample_unnamed(crane).effects  # type: ignore[union-attr]


def test_a_result_of_before_there_were_seals_is_read(crane: Dataset, tmp_path: Path) -> None:
    save_gap(tmp_path / "gap", sample_gap(crane))
    (tmp_path / "gap" / "seal.json").unlink()
    assert load_gap(tmp_path / "gap") is not None


def test_nothing_there_and_something_broken(tmp_path: Path) -> None:
    assert load_gap(tmp_path) is None
    (tmp_path / "result.json").write_text("{")
    with pytest.raises(StoreError, match="Run `sysid gap` again"):
        load_gap(tmp_path)


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("dataset",), None), (("plant", "before"), []), (("plant", "after"), 1), (("verdict",), "good"), (("verdict",), []),
        (("seconds",), "long"), (("notes",), [1]), (("effects", 0, "interval95", "positive"), ["a", "b"]),
        (("effects", 0, "interval95", "positive"), [[], 1.0]),
        (("gap", "before", "ee.x"), 1e308), (("gap", "before"), []),
        (("maps", 0, "at"), []), (("maps", 0, "at", 0), None),
        (("maps", 0, "mean"), [1.0]), (("held_out_recordings",), [None]), (("settings",), []),
    ],
)  # fmt: skip
def test_a_value_of_another_type_is_refused(
    place: tuple[str | int, ...], value: object, crane: Dataset, tmp_path: Path
) -> None:
    """A seal proves nothing about who wrote it: it can be left out."""
    path = save_gap(tmp_path / "gap", sample_gap(crane))
    (tmp_path / "gap" / "seal.json").unlink()
    content = json.loads(path.read_text("utf-8"))
    holder = content
    for key in place[:-1]:
        holder = holder[key]
    holder[place[-1]] = value
    path.write_text(json.dumps(content), "utf-8")
    with pytest.raises(StoreError, match=r"result.json: not readable .*Run `sysid gap` again"):
        load_gap(tmp_path / "gap")
