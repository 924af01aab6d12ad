"""Excitation verdicts before a fit equal those of the gap workflow, and say what to record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from plant_data import CAPTURE, KnownEffect, arm, dataset_of, loaded_arm, nominal, slide

from sysid.datasets.quality.evidence import THRESHOLDS
from sysid.datasets.recording import Dataset, Recording
from sysid.effects import BY_NAME, CATALOGUE
from sysid.gap import find_gap
from sysid.gap.excitation import COUNTS
from sysid.gap.experiment.excitation_verdict import ExcitationReport, ExcitationVerdict, excitation_report
from sysid.gap.result import Excitation

Array = npt.NDArray[np.float64]
LAG = KnownEffect("first_order_lag", "slew", {"time_constant": 0.1})


@pytest.fixture(scope="module")
def short() -> Dataset:
    return dataset_of(nominal(LAG), 8.0)


def verdict(found: ExcitationReport, name: str, target: str, side: str | None = None) -> ExcitationVerdict:
    (match,) = (v for v in found.verdicts if (v.name, v.target, v.side) == (name, target, side))
    return match


def changed(dataset: Dataset, change: Callable[[int, Recording], dict[str, Array]]) -> Dataset:
    tables = (r.table.assign(**change(k, r)) for k, r in enumerate(dataset.recordings))
    return replace(
        dataset, recordings=tuple(replace(r, table=table) for r, table in zip(dataset.recordings, tables, strict=True))
    )


@pytest.mark.parametrize("machine", ["arm", "capture", "slide"])
def test_the_verdicts_are_the_excitation_of_the_gap_workflow(machine: str, short: Dataset) -> None:
    if machine == "slide":
        plant, dataset = nominal(machine=slide()), dataset_of(nominal(machine=slide()), 6.0)
    else:
        plant = nominal(machine=arm(), streams=CAPTURE if machine == "capture" else None)
        dataset = replace(short, streams=CAPTURE) if machine == "capture" else short
    result = find_gap(dataset, plant, localise_only=True)
    found = excitation_report(dataset, plant)
    counted = [v for v in found.verdicts if v.status != "hidden" and BY_NAME[v.name].fitted]
    excitations = [Excitation(v.name, v.target, v.status == "ready", v.have, v.need, v.unit) for v in counted]
    assert tuple(excitations) == result.excitation
    lacking = [v.text for v in found.of("lacking") if BY_NAME[v.name].fitted]
    assert result.verdict == "no_gap" or list(dict.fromkeys(lacking)) == list(result.next_experiment)


def test_four_reversals_are_said_to_be_four(short: Dataset) -> None:
    """The slew turns four times in the recordings to fit and to select; its sensor's noise turns thousands of times."""

    def turned(k: int, recording: Recording) -> dict[str, Array]:
        corners = ([0.0, 0.4, 0.0, 0.4], [0.4, 0.1, 0.4], [0.4, 0.0, 0.3], [0.3, 0.0, 0.3, 0.0])[k]
        path = np.interp(np.linspace(0, len(corners) - 1, len(recording)), np.arange(len(corners)), corners)
        return {"slew.joint": path + np.random.default_rng(k).normal(0.0, 2e-3, len(recording))}

    found = excitation_report(changed(short, turned), nominal())
    play = verdict(found, "backlash", "slew", "drive")
    assert (play.status, play.have, play.need) == ("lacking", 4.0, 8.0)
    assert play.text == (
        "Backlash of slew: 4 reversals, about 8 needed. "
        "Record 20 slow reversals of slew, with at least 5 % of its range between them."
    )
    sides = [request.effects.count(("backlash", "slew")) for request in found.requests]
    assert sum(sides) == 1, "one request for both sides of the sensor"


def test_sufficient_recordings_are_ready_for_every_effect() -> None:
    machine = loaded_arm()
    plant = nominal(machine=machine, streams=CAPTURE)
    found = excitation_report(replace(dataset_of(nominal(machine=machine), 90.0), streams=CAPTURE), plant)
    assert [v.text for v in found.of("lacking")] == []
    assert found.requests == ()
    names = {v.name for v in found.of("ready")}
    others = {effect.name for effect in CATALOGUE if effect.actuations and set(effect.actuations) <= {"force", "servo"}}
    force_only = others | {effect.name for effect in CATALOGUE if effect.of_links}
    described = {effect.name for effect in CATALOGUE if effect.described_only}
    assert names == {effect.name for effect in CATALOGUE} - force_only - described


def test_axes_that_need_the_same_recording_share_a_request(short: Dataset) -> None:
    found = excitation_report(short, nominal())
    request = next(request for request in found.requests if ("temperature_drift", "slew") in request.effects)
    assert request.record == "Record slew and boom moving evenly to and fro for ten minutes from a cold start."
    served = [effect for request in found.requests for effect in request.effects]
    assert sorted(served) == sorted({(v.name, v.target) for v in found.of("lacking")})
    assert [len(request.effects) for request in found.requests] == sorted(
        (len(w.effects) for w in found.requests), reverse=True
    )


def test_an_unobservable_effect_has_a_reason(short: Dataset) -> None:
    unseen = changed(short, lambda k, r: {s: np.full(len(r), np.nan) for s in ("boom.joint", "tool.x", "tool.y", "tool.z")})
    found = excitation_report(unseen, nominal())
    assert verdict(found, "backlash", "boom", "drive").text == "boom.joint is not measured"
    assert verdict(found, "gripper_sway", "tool").text == "tool is not measured"
    assert verdict(found, "sensor_scale", "boom.cylinder").text == "boom.joint is not measured"
    assert verdict(found, "sensor_bias", "slew.joint").text.startswith("no other sensor measures the same")
    sag = verdict(found, "joint_compliance", "slew", "structure")
    assert (sag.status, sag.have, sag.need) == ("hidden", None, None)
    bare = excitation_report(dataset_of(nominal(machine=slide()), 6.0), nominal(machine=slide()))
    assert verdict(bare, "base_misalignment", "base").text == "machine.toml names no URDF"
    assert "force at measured motion" in verdict(bare, "backlash", "slide", "drive").text
    assert not [v for v in bare.verdicts if v.name == "valve_deadband"], "a force has no valve"


def test_every_place_has_one_verdict(short: Dataset) -> None:
    found = excitation_report(short, nominal())
    places = [(v.name, v.target, v.side) for v in found.verdicts]
    assert len(places) == len(set(places))
    assert all((v.have is None) == (v.status == "hidden") and v.text for v in found.verdicts)
    assert all(bool(v.record) == (v.status == "lacking") for v in found.verdicts)


def test_only_fit_and_selection_recordings_are_counted(short: Dataset) -> None:
    assert excitation_report(short, nominal()).counted == ("run-1", "run-2", "run-3")


def test_too_few_recordings_are_counted_all_the_same(short: Dataset) -> None:
    alone = replace(short, recordings=short.recordings[:1], splits={"run-1": "fit"})
    found = excitation_report(alone, nominal())
    (note,) = found.notes
    assert note.startswith("sysid gap will need 4 s of recorded motion or more in each role (fit, selection and test); ")
    assert verdict(found, "input_delay", "slew").have is not None


def test_json_has_the_words(short: Dataset) -> None:
    found = excitation_report(short, nominal())
    value = found.to_json()
    assert value["verdicts"][0]["text"] == found.verdicts[0].text
    assert {"text", "effects"} == set(value["record"][0])


def test_the_guide_explains_every_count_and_threshold() -> None:
    guide = " ".join((Path(__file__).parents[3] / "docs" / "guide" / "quality.md").read_text("utf-8").split())
    counted = guide[guide.index("| counted in") : guide.index("How much each effect needs")]
    for _, unit in COUNTS.values():
        assert all(word in counted for word in unit.split()), unit
    for name, value in THRESHOLDS.items():
        assert f"`{name}`" in guide, name
        assert value is not None
