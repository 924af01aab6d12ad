"""The wrong-unit matrix: mistakes in units, signs and columns are named with their factor, and right data give no alarm."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import wrong_units
from wrong_units import Cell, arm_cells, caught, changed, crane_cells, cut, described, excavator_cells, slide_cells, times

from sysid.datasets import Dataset, ingest
from sysid.datasets.checks.run import DATASET_CHECKS, check_plausibility

AUTOLOG = Path(__file__).parents[2] / "datasets/autolog"
#: Share of the cells of a machine that has to be caught, as the issue of this check states it.
CAUGHT = 0.95


@pytest.fixture(scope="module")
def crane(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The shipped crane, the first 45 s of its recordings."""
    return cut(ingest(AUTOLOG, tmp_path_factory.mktemp("crane")), 45.0)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return wrong_units.servo_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def slide(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return wrong_units.slide(tmp_path_factory.mktemp("slide"))


def run(dataset: Dataset, cells: Sequence[Cell], folder: Path) -> list[str]:
    """The cells that are not caught."""
    missed = []
    for number, cell in enumerate(cells):
        place = folder / f"cell-{number}"
        place.mkdir()
        # Stamps go through ingest: a few seconds are enough there, since a thousand times as many rows follow.
        used = cut(dataset, 800.0 / max(dataset.machine.rate_hz, 100.0)) if cell.signal == "time" else dataset
        found, what = caught(cell, used, place)
        shutil.rmtree(place)
        if not found:
            missed.append(f"{cell.signal}, {cell.mistake}: {what}")
    return missed


def enough(dataset: Dataset, cells: Sequence[Cell], folder: Path) -> None:
    assert check_plausibility(dataset) == ()
    missed = run(dataset, cells, folder)
    assert len(missed) <= (1.0 - CAUGHT) * len(cells), f"{len(missed)} of {len(cells)}: {missed}"


@pytest.mark.slow
def test_matrix_of_the_crane(crane: Dataset, tmp_path: Path) -> None:
    enough(crane, crane_cells(), tmp_path)


@pytest.mark.slow
def test_matrix_of_the_servo_arm(arm: Dataset, tmp_path: Path) -> None:
    enough(arm, arm_cells(), tmp_path)


@pytest.mark.slow
def test_matrix_of_the_slide(slide: Dataset, tmp_path: Path) -> None:
    enough(slide, slide_cells(), tmp_path)


@pytest.mark.slow
def test_matrix_of_the_excavator(shared_data: Path, datasets_folder: Path, tmp_path: Path) -> None:
    recipe = datasets_folder / "rc_excavator/recipe.toml"
    dataset = ingest(shared_data / "rc_excavator", tmp_path / "workspace", recipe=recipe)
    enough(dataset, excavator_cells(), tmp_path)


def some(cells: Callable[[], list[Cell]], *names: tuple[str, str]) -> list[Cell]:
    found = [cell for cell in cells() if (cell.signal, cell.mistake) in names]
    assert len(found) == len(names)
    return found


def test_one_mistake_of_every_kind(arm: Dataset, slide: Dataset, tmp_path: Path) -> None:
    of_arm = some(
        arm_cells,
        ("command", "degrees as rad"),
        ("command", "exchanged columns"),
        ("joint", "rad as degrees"),
        ("joint", "sign"),
        ("ee", "mm as m"),
        ("ee", "exchanged columns"),
        ("time", "s as ms"),
    )
    of_slide = some(slide_cells, ("command", "N as kN"), ("joint", "mm as m"), ("joint", "limits in mm in machine.toml"))
    (tmp_path / "arm").mkdir()
    (tmp_path / "slide").mkdir()
    assert run(arm, of_arm, tmp_path / "arm") == []
    assert run(slide, of_slide, tmp_path / "slide") == []


def test_the_same_mistake_of_several_axes_is_said_once(arm: Dataset) -> None:
    degrees = {
        f"{axis}.{part}": lambda q: q * wrong_units.DEGREES for axis in ("shoulder", "elbow") for part in ("command", "joint")
    }
    (finding,) = [each for each in check_plausibility(changed(arm, degrees)) if each.severity == "severe"]
    assert len(finding.keys) == 2
    subjects = ("shoulder.command", "shoulder.joint", "elbow.command", "elbow.joint")
    assert finding.causes[0].subjects == subjects
    assert finding.causes[0].factor == pytest.approx(wrong_units.DEGREES)


def test_both_are_named_where_the_data_cannot_decide(slide: Dataset) -> None:
    """Without limits, ten times the mass is a force in another unit as well as a wrong inertia."""
    text = slide.machine.text
    assert "limits" in text
    free = described(slide, lambda text: "\n".join(line for line in text.splitlines() if not line.startswith("limits")))
    (finding,) = check_plausibility(described(free, times("inertia", 1e-3)))
    assert any("inertia" in cause.text for cause in finding.causes)
    assert len(finding.causes) > 1


@pytest.mark.parametrize("ratio", [0.5, 0.7, 1.5, 2.0])
def test_a_gain_that_is_off_by_less_than_two_is_an_effect_and_no_mistake(crane: Dataset, ratio: float) -> None:
    assert check_plausibility(described(crane, times("gain", ratio))) == ()


@pytest.mark.parametrize("factor", [180.0 / np.pi, np.pi / 180.0, -1.0])
def test_a_mistake_in_some_recordings_only_is_found_there(crane: Dataset, factor: float) -> None:
    """Another layout, logger or day; over all recordings the axis looks right, or is too large."""
    chosen = [r.name for r in crane.of_kind("motion")][-2:]
    recordings = [
        replace(r, table=r.table.assign(**{"slew.joint": factor * r.values("slew.joint")})) if r.name in chosen else r
        for r in crane.recordings
    ]
    found = [f for f in check_plausibility(replace(crane, recordings=tuple(recordings))) if "slew" in f.keys[0]]
    assert [f.severity for f in found] == ["severe"]
    assert found[0].causes[0].factor == pytest.approx(factor, rel=1e-3)
    if factor < 1.0:
        assert found[0].recordings == tuple(chosen)


def test_an_end_stop_inside_the_limits_is_named(crane: Dataset) -> None:
    """The simulation would run on where the machine stops; the place is named, to be written into the description."""
    top = float(np.nanquantile(np.concatenate([r.values("slew.joint") for r in crane.of_kind("motion")]), 0.75))
    stopped = changed(crane, {"slew.joint": lambda q: np.minimum(q, top) + 1e-4 * np.random.default_rng(0).normal(size=len(q))})
    found = [f for f in check_plausibility(stopped) if f.keys == ("slew:end_stop",)]
    assert [f.severity for f in found] == ["notice"]
    place, high = (
        re.search(r"stays at (\S+) rad", found[0].evidence[0].found),
        re.search(r", (\S+)\]", found[0].causes[0].remedy),
    )
    assert place is not None
    assert high is not None
    assert float(place[1]) == float(high[1]) == pytest.approx(top, abs=2e-4)


def test_an_axis_that_does_not_move_in_a_role(arm: Dataset) -> None:
    recordings = [
        replace(
            r,
            table=r.table.assign(**{"elbow.joint": r.values("elbow.joint")[0], "elbow.command": r.values("elbow.command")[0]}),
        )
        if arm.splits[r.name] == "held_out"
        else r
        for r in arm.recordings
    ]
    found = check_plausibility(replace(arm, recordings=tuple(recordings)))
    assert [(each.keys, each.severity) for each in found if "elbow:still" in each.keys] == [(("elbow:still",), "notice")]
    assert "does not move in the test recordings" in next(f for f in found if "elbow:still" in f.keys).evidence[0].found


def test_a_constant_sensor_of_a_commanded_axis_is_severe(arm: Dataset) -> None:
    found = check_plausibility(changed(arm, {"elbow.joint": lambda q: 0.0 * q + 0.3}))
    assert ("elbow.joint:constant",) in [each.keys for each in found if each.severity == "severe"]


def test_the_page_names_every_kind_of_finding() -> None:
    """And none that no check of the list has."""
    text = (Path(__file__).parents[2] / "docs/guide/wrong-data.md").read_text("utf-8")
    table = text[text.index("## Symptoms") : text.index("## What is compared")]
    assert set(re.findall(r"`[a-z.]+:(\w+)`", table)) == {kind for kinds in DATASET_CHECKS.values() for kind in kinds}


def test_a_column_without_values(arm: Dataset) -> None:
    found = check_plausibility(changed(arm, {"ee.y": lambda values: values * float("nan")}))
    assert [each.keys for each in found] == [("ee.y:missing",)]


@pytest.mark.slow
def test_no_alarm_on_measured_data(shared_data: Path, datasets_folder: Path, tmp_path: Path) -> None:
    """The machines in datasets/ with their recipes; what is found is that axes stand still."""
    sets = [
        ("emps", "emps"),
        ("hyd_actuator", "hydraulic_actuator"),
        ("rc_excavator", "rc_excavator"),
        ("bam_xl330", "xl330"),
        ("double_pendulum", "double_pendulum"),
        *((f"sage_so101/{run}", "so101") for run in ("friction_gravity", "multisine", "step_response", "single_joint_elbow")),
    ]
    for logs, name in sets:
        dataset = ingest(shared_data / logs, tmp_path / logs, recipe=datasets_folder / name / "recipe.toml")
        found = check_plausibility(dataset)
        assert {key.rpartition(":")[2] for each in found for key in each.keys} <= {"still"}, (
            logs,
            [each.lines for each in found],
        )
        if logs != "sage_so101/single_joint_elbow":  # four of six servos are not commanded there
            assert sum(len(each.keys) for each in found) <= 1, logs
