"""What follows the decision may fail or be interrupted: the names stay, they are kept first, and what is missing is listed."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from plant_data import dataset_of, nominal, slide

from sysid.datasets.recording import Dataset
from sysid.errors import StorageError
from sysid.gap import find_gap
from sysid.gap.experiment import Planning
from sysid.gap.following import NOT_REACHED, STORED_RESULT, Fields, Following, completed
from sysid.gap.result import GapResult
from sysid.gap.statement import missing_sentences
from sysid.machine import KnownEffect
from sysid.registry import Registry
from sysid.reports import build_report
from sysid.reports.inputs import ReportInputs
from sysid.workspace import Workspace

COULOMB = KnownEffect("coulomb_friction", "slide", {"force": 18.0})
#: Name of a part that ``--add`` with planning computes → the method that gives it.
PARTS = {
    "errors on held-out recordings": "errors",
    "errors in the PyBullet world": "world",
    "values that the repair writes": "written",
    "stored repair": "store",
    "promotion": "promote",
    "next recordings": "next_recordings",
    "shares of the stages": "shares",
    "maps of the error": "maps",
    "planned recordings": "plan",
}


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return dataset_of(nominal(COULOMB, machine=slide()), 4.0)


@pytest.fixture(scope="module")
def whole(dataset: Dataset) -> GapResult:
    return find_gap(dataset, nominal(machine=slide()), planning=Planning())


def fail(*_: object) -> Fields:
    raise ValueError("array must not contain infs or NaNs")


def test_nothing_is_missing_where_nothing_fails(whole: GapResult) -> None:
    assert whole.missing == ()
    assert whole.gap.before
    assert whole.stage_gap.before
    assert whole.written
    assert whole.maps


def test_names_stay_where_everything_after_them_fails(
    dataset: Dataset, whole: GapResult, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for method in PARTS.values():
        monkeypatch.setattr(Following, method, fail)
    place, kept = Workspace(tmp_path), list[GapResult]()

    def keep(result: GapResult) -> None:
        kept.append(result)
        place.keep_gap(dataset, result)

    plant = nominal(machine=slide())
    found = find_gap(dataset, plant, place.models, add=True, planning=Planning(), keep=keep)
    assert (found.verdict, found.effects, found.plant_after) == ("named", whole.effects, "")
    assert [item.part for item in found.missing] == list(PARTS)
    assert all(item.reason.startswith("ValueError: array must not contain infs or NaNs (") for item in found.missing)
    first, last = kept
    assert first.effects == whole.effects
    assert [(item.part, item.reason) for item in first.missing] == [(name, NOT_REACHED) for name in PARTS]
    assert last.missing == found.missing
    stored = place.gap(dataset)
    assert stored is not None
    assert (stored.missing, stored.effects) == (found.missing, whole.effects)
    page = build_report(ReportInputs(dataset, gap=stored))
    assert all(sentence in page for sentence in missing_sentences(found.missing))


def test_a_repair_without_proof_is_not_stored(dataset: Dataset, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(Following, "errors", fail)
    registry = Registry(tmp_path)
    found = find_gap(dataset, nominal(machine=slide()), registry, add=True)
    missing = {item.part for item in found.missing}
    assert {"errors on held-out recordings", "stored repair", "promotion"} <= missing
    assert (found.plant_after, found.promotion) == ("", None)
    assert len(registry.list("plant")) == 1, "the plant under test alone"


def test_an_interrupted_plan_leaves_the_answer(
    dataset: Dataset, whole: GapResult, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupted(*_: object) -> Fields:
        raise KeyboardInterrupt

    monkeypatch.setattr(Following, "plan", interrupted)
    place = Workspace(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        find_gap(dataset, nominal(machine=slide()), planning=Planning(), keep=lambda result: place.keep_gap(dataset, result))
    stored = place.gap(dataset)
    assert stored is not None
    assert stored.effects == whole.effects
    assert "planned recordings" in {item.part for item in stored.missing}


def test_parts_are_computed_in_order_and_alone(whole: GapResult) -> None:
    order = []

    def part(name: str) -> Fields:
        order.append(name)
        if name == "b":
            raise ZeroDivisionError
        return {"notes": (name,)}

    found = completed(whole, {name: partial(part, name) for name in "abc"})
    assert (order, found.notes) == (["a", "b", "c"], ("c",))
    (missing,) = found.missing
    assert missing.part == "b"
    assert missing.reason.startswith("ZeroDivisionError: no text (")


def test_a_result_that_cannot_be_stored_is_still_the_answer(whole: GapResult) -> None:
    def full(result: GapResult) -> None:
        raise StorageError("workspace", "no space left")

    found = completed(whole, {}, full)
    assert replace(found, missing=()) == whole
    assert [item.part for item in found.missing] == [STORED_RESULT]


@pytest.mark.slow
def test_a_fault_of_the_program_is_named_with_its_place(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid.gap.following.propose", lambda *_: 1 / 0)
    found = find_gap(dataset, nominal(machine=slide()), planning=Planning())
    (missing,) = found.missing
    assert missing.part == "planned recordings"
    assert missing.reason.startswith("ZeroDivisionError: division by zero (sysid/gap/following.py, line ")
