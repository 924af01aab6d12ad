"""The loop: what is sealed stays sealed, runs on the bench repeat, and rows say what happened."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from rerun_file import curves

from simulated_bench.recipe import AXES
from sysid.gap import GapResult
from sysid.gap.result import Gap, NamedEffect, WrittenEffect
from sysid.machine import KnownEffect, load_machine
from sysid.plant import nominal_plant
from sysid_rl.train.inverse_kinematics import chain_of_plant
from sysid_rl.train.reach import joint_limits


@pytest.fixture(scope="module")
def loop(pipeline: Callable[[str], ModuleType]) -> Any:
    """The pipeline's file; its parts are importable from then on."""
    return pipeline("close_the_gap")


@pytest.fixture(scope="module")
def site(loop: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    machine = loop.draw_machine(3)
    found = loop.Site(machine, tmp_path_factory.mktemp("machine"))
    loop.write_site(machine, found.description)
    return found


def test_a_seed_draws_one_machine(loop: Any) -> None:
    assert loop.draw_machine(3) == loop.draw_machine(3)
    assert loop.draw_machine(3).hidden != loop.draw_machine(4).hidden


@pytest.mark.parametrize("seed", range(6))
def test_every_machine_hides_all_kinds(loop: Any, seed: int) -> None:
    machine = loop.draw_machine(seed)
    names = [effect.name for effect in machine.hidden]
    kinds = {"gripper_sway": 1, "backlash": 2, "valve_deadband": 3, "input_delay": 2, "joint_offset": 2}
    assert {name: names.count(name) for name in kinds} == kinds
    for effect in machine.hidden:
        if effect.name == "valve_deadband":
            valve = machine.real.axis(effect.target).valve
            assert (valve.deadband_positive, valve.deadband_negative) == tuple(effect.parameters.values())
            assert valve.deadband_positive != valve.deadband_negative


def test_the_description_holds_nothing_hidden(site: Any) -> None:
    described = load_machine(site.description / "machine.toml")
    plant = nominal_plant(described)
    for effect in site.machine.hidden:
        known = plant.effect(effect.name, effect.target, "drive" if effect.name == "backlash" else None)
        assert known is None or all(known.parameters[key] != value for key, value in effect.parameters.items())
    written = "".join(path.read_text("utf-8") for path in site.description.iterdir())
    assert not [value for effect in site.machine.hidden for value in effect.parameters.values() if str(value) in written]


def test_the_truth_is_what_the_machine_hides(loop: Any, site: Any, tmp_path: Path) -> None:
    loop.write_truth(site.machine, tmp_path / "sealed" / "truth.json")
    hidden = loop.read_truth(tmp_path / "sealed" / "truth.json")
    assert [(each["name"], each["target"]) for each in hidden] == [(e.name, e.target) for e in site.machine.hidden]


def test_the_true_plant_moves_the_tip_as_the_machine_is_built(loop: Any, site: Any) -> None:
    machine, nominal = site.machine, site.nominal()
    hidden = [{"name": e.name, "target": e.target, "parameters": e.parameters} for e in machine.hidden]
    parked = {name: machine.visible.axis(name).park for name in AXES}
    true = loop.true_plant(nominal, hidden, parked)
    joints = np.array([list(parked.values())])
    moved = joints.copy()
    for bent in (effect for effect in machine.hidden if effect.name == "joint_offset"):
        moved[0, AXES.index(bent.target)] += bent.parameters["offset"]
    np.testing.assert_allclose(chain_of_plant(true).predict(joints), chain_of_plant(nominal).predict(moved), atol=1e-9)


def test_a_guess_has_the_mean_of_what_is_inverted_and_the_worst_of_what_is_stabilised(loop: Any, site: Any) -> None:
    nominal = site.nominal()
    guessed = loop.guessed_plant(nominal, np.random.default_rng(0))
    for name, key, low, high in (
        ("input_delay", "delay", 1.15, 1.2),
        ("first_order_lag", "time_constant", 1.15, 1.2),
        ("valve_deadband", "positive", 0.94, 1.06),
        ("valve_deadband", "negative", 0.94, 1.06),
    ):
        for axis in AXES:
            ratio = guessed.effect(name, axis).parameters[key] / nominal.effect(name, axis).parameters[key]
            assert low <= ratio <= high, (name, axis)
    assert guessed.effect("gain_error", "boom").parameters["ratio"] == pytest.approx(1.0, abs=0.06)


def test_the_forward_model_is_the_plants_kinematics(site: Any) -> None:
    from loop.models import forward_of

    plant = site.nominal()
    low, high = joint_limits(plant)
    joints = np.random.default_rng(0).uniform(low, high, (50, len(low)))
    np.testing.assert_allclose(forward_of(plant).predict(joints), chain_of_plant(plant).predict(joints), atol=1e-5)


@pytest.mark.slow
def test_runs_on_the_bench_repeat_and_are_recordings(loop: Any, site: Any, tmp_path: Path) -> None:
    from loop.flight import SIGNALS, fly
    from loop.recording import ingest_flights

    deployment, models = site.deployment(site.nominal(), identified=False), site.workspace.models
    time = np.arange(0.0, 3.0, 0.01)
    parked = np.array([site.machine.visible.axis(name).park for name in AXES])
    joints = parked + np.outer(0.5 - 0.5 * np.cos(2.0 * np.pi * time / 3.0), [0.2, 0.1, 0.1, 0.03])
    head = ",".join(["time", *(f"{name}.joint" for name in AXES)])
    np.savetxt(tmp_path / "strokes.csv", np.column_stack([time, joints]), delimiter=",", header=head, comments="")
    task, logs = {"mode": "replay", "replay": {"file": str(tmp_path / "strokes.csv")}}, tmp_path / "flights"
    one, two = (fly(site.machine.real, site.description, logs, models, deployment, task, 7) for _ in range(2))
    assert (one.ended, one.why) == ("done", "replay is done")
    # All but the head line of a take, which has its name and date.
    takes = [(flight.log / "mocap.csv").read_text("utf-8").split("\n", 1)[1] for flight in (one, two) if flight.log]
    assert one.log != two.log
    assert takes[0] == takes[1]
    dataset = ingest_flights(logs, site.machine.visible, tuple(SIGNALS), tmp_path / "workspace")
    # Of two recordings blocks are fitted and held out: <name>#1 ….
    assert {each.name.partition("#")[0] for each in dataset.recordings} == {each.log.name for each in (one, two) if each.log}
    table = dataset.recordings[0].table
    assert {"boom.command", "boom.cylinder", "boom.joint", "ee.z", "tool.z"} <= set(table)
    hangs = float(np.nanmedian(table["ee.z"] - table["tool.z"]))
    assert hangs == pytest.approx(site.machine.real.gripper.length, abs=1e-3)


@pytest.mark.slow
def test_the_hidden_errors_are_those_of_the_tool(loop: Any, site: Any) -> None:
    """The described machine follows within millimetres; the sealed one does not."""
    from loop.flight import fly

    deployment, models = site.deployment(site.nominal(), identified=False), site.workspace.models
    task = {"mode": "track", "track": {"path": "circle"}}
    worst = {}
    for name in ("visible", "real"):
        machine = getattr(site.machine, name)
        flight = fly(machine, site.description, site.folder / name, models, deployment, task, 1)
        worst[name] = float(np.abs(flight.error).max())
    assert worst["visible"] < 0.002
    assert worst["real"] > 0.030


def test_the_next_round_has_the_named_effects_only(loop: Any, site: Any) -> None:
    from loop.models import named_part

    nominal = site.nominal()
    lag = nominal.effect("first_order_lag", "slew")
    assert lag is not None
    repaired = nominal
    for name, target, values in (
        ("valve_deadband", "slew", {"positive": 0.4, "negative": 0.3}),
        ("first_order_lag", "slew", {"time_constant": 0.2}),
        ("stiction", "slew", {"breakaway": 0.05, "release": 0.01}),
    ):
        repaired = repaired.with_effect(KnownEffect(name, target, dict(values)))
    written = (
        WrittenEffect("valve_deadband", "slew", "named", {"positive": 0.4, "negative": 0.3}),
        WrittenEffect("first_order_lag", "slew", "adjusted", {"time_constant": 0.2}, before=dict(lag.parameters)),
        WrittenEffect("stiction", "slew", "adjusted", {"breakaway": 0.05, "release": 0.01}),
    )
    kept = named_part(repaired, gap_result(written=written))
    expected = nominal.with_effect(KnownEffect("valve_deadband", "slew", {"positive": 0.4, "negative": 0.3}))
    np.testing.assert_array_equal(kept.vector(), expected.vector())


# ---- Rows ---------------------------------------------------------------------------------------------------------------


def effect(name: str, target: str, aliases: tuple[tuple[str, str], ...] = ()) -> NamedEffect:
    return NamedEffect(name, target, {"width": 0.01}, {"width": (0.009, 0.011)}, 0.5, aliases=aliases)


def gap_result(*named: NamedEffect, written: tuple[WrittenEffect, ...] = ()) -> GapResult:
    signals = [f"{point}.{letter}" for point in ("ee", "tool") for letter in "xyz"]
    none = Gap(*(dict.fromkeys(signals, value) for value in (0.1, 0.01, 0.005)))
    return GapResult("crane@1", "crane@1", "crane@2", "named", named, (), (), (), none, none, (), (), 1.0, written=written)


def test_a_policy_of_a_plant_is_deployed_with_its_controller(
    loop: Any, site: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    import loop.policies as policies

    short = policies.RECIPE.read_text("utf-8").replace("steps = 100", "steps = 20").replace("episodes = 2560", "episodes = 64")
    (tmp_path / "short.toml").write_text(short.replace("copies = 64", "copies = 16"), "utf-8")
    monkeypatch.setattr(policies, "RECIPE", tmp_path / "short.toml")
    nominal = site.nominal()
    found = policies.policy_deployment(site, nominal, site.deployment(nominal))
    version = site.workspace.models.find(found.policy)
    assert (version.kind, version.lineage["plant"]) == ("policy", nominal.reference)
    assert version.lineage["forward"] == found.forward
    assembly = found.assembled(site.workspace.models, site.description, {"mode": "track", "track": {"path": "helix"}})
    assert found.policy in [each.reference for each in assembly.loaded.versions]


@pytest.mark.parametrize("excitation", [False, True])
def test_the_loop_ends_when_nothing_more_is_named(loop: Any, monkeypatch: pytest.MonkeyPatch, excitation: bool) -> None:
    """A repair that is not promoted is deployed too; a proposed experiment is made in the next round."""
    from types import SimpleNamespace

    import loop.rounds as rounds

    wanted = SimpleNamespace(name="slew-taps", repeats=2)
    none = replace(gap_result(), experiments=(wanted,) if excitation else ())
    gaps = [gap_result(effect("backlash", "slew")), none, gap_result()]
    flown: list[str] = []
    checked: list[tuple[str, bool]] = []
    monkeypatch.setattr(rounds, "fly_paths", lambda site, plant, paths: {"helix": SimpleNamespace(figures=dict)})
    monkeypatch.setattr(rounds, "simulate_paths", lambda site, plant: {})
    monkeypatch.setattr(rounds, "find_gap", lambda *given, **named: gaps.pop(0))
    monkeypatch.setattr(rounds, "named_part", lambda plant, gap: plant)
    monkeypatch.setattr(rounds, "write_experiment", lambda folder, experiment: folder / f"{experiment.name}.toml")
    plant = SimpleNamespace(reference="crane@1")
    site = SimpleNamespace(
        nominal=lambda: plant,
        registered=lambda plant, lineage: SimpleNamespace(reference="crane@3"),
        plant=lambda reference: plant,
        dataset=lambda: None,
        deployment=lambda plant, identified: checked.append((plant.reference, identified)),
        fly=lambda deployment, task: flown.append(Path(task["experiment"]["file"]).stem),
        folder=Path("machine"),
        workspace=SimpleNamespace(models=None, keep_gap=lambda dataset, gap: None),
    )
    found = rounds.close_gap(site, lambda text: None)
    assert [each.plant for each in found] == ["crane@1", "crane@3", "crane@3"][: 3 if excitation else 2]
    assert [each.experiments for each in found] == [(), (), ("slew-taps",) * 2][: len(found)]
    assert flown == ["slew-taps"] * (2 if excitation else 0)
    assert checked == [("crane@1", False), ("crane@3", True), ("crane@3", True)][: len(found)], "wide thresholds at first only"


def test_names_are_compared_with_the_truth(loop: Any) -> None:
    from loop.flight import Flight
    from loop.page import CONTROLLERS
    from loop.rounds import Round

    ramp = np.linspace(0.0, 0.03, 31)
    tool = np.column_stack([ramp, 0.0 * ramp, -ramp])
    flight = Flight("helix", ramp, 0.0 * tool, 0.5 * tool, tool, np.zeros((31, 4)), "done", "")
    flights = {"helix": flight, "circle": flight}
    first = gap_result(
        effect("backlash", "slew"),
        effect("link_length_error", "boom", (("joint_offset", "stick"),)),
        effect("stiction", "boom"),
        written=(WrittenEffect("input_delay", "boom", "adjusted", {"delay": 0.1}),),
    )
    rounds = [
        Round("crane@1", flights, flights, first, {"gap": 2.0}, 1.5),
        Round("crane@2", flights, flights, None, {"deploy": 3.0}, 1.0),
    ]
    hidden = [
        {"name": name, "target": target, "parameters": {}}
        for name, target in (("backlash", "slew"), ("joint_offset", "stick"), ("input_delay", "boom"), ("backlash", "stick"))
    ]
    found = loop.machine_result("seed 9", hidden, rounds)
    assert found["missed"] == [("input_delay", "boom"), ("backlash", "stick")]
    assert found["adjusted"] == [("input_delay", "boom")]
    assert found["wrong"] == [("stiction", "boom")]
    assert found["rounds"][0]["helix"]["max_mm"] == pytest.approx([30.0, 0.0, 30.0])
    assert found["rounds"][0]["helix"]["tip_max_mm"] == pytest.approx([15.0, 0.0, 15.0])
    json.dumps(found, allow_nan=False)

    refused = {path: {"ended": "refused", "why": "needs 110 % of the top speed of slew"} for path in flights}
    run = found["rounds"][1]
    compared = dict.fromkeys(CONTROLLERS, run) | {"lag_delay_gain": refused}
    text = loop.tables({"machines": [{**found, "compared": compared}]}).replace("`", "")
    assert "| seed 9 | 4 | 2 | input_delay boom (adjusted without a name), backlash stick | stiction boom |" in text
    assert "| seed 9 | 0 | 173.21 | 17.32 | 8.66 | 173.21 | 17.32 | 8.66 |" in text
    assert "| error after, largest coordinate | ≤ 20 mm | 30.0 mm | 0 of 1 |" in text
    assert "| beside the repaired simulation | ≤ 1.3 | 1.00 | 1 of 1 |" in text
    assert "| hidden effects named | all, none wrong | 2 of 4, 1 wrong | 0 of 1 |" in text
    assert "| naming beside a guess of ±20 % | ≥ 2 times better | 1.0 times | 0 of 1 |" in text
    assert "| naming beside least squares without dead-bands | ≥ 2 times better | refused | 1 of 1 |" in text
    assert "| beside a policy trained for the true plant | ≤ 1.2 | 1.00 | 1 of 1 |" in text
    assert "| wall time from first to second deployment | ≤ 30 min | 5 s | 1 of 1 |" in text
    assert "| seed 9 | true plant | 30 / 0.0 / 30 |" in text
    assert "| seed 9 | dead time, lag and gain by least squares | refused: needs 110 % of the top speed of slew | – |" in text


def test_the_story_shows_both_rounds_and_the_findings(loop: Any, site: Any, tmp_path: Path) -> None:
    from loop.flight import Flight
    from loop.rounds import Round
    from loop.story import write_story

    time = np.linspace(3.0, 4.0, 101)
    zero, joints = np.zeros((101, 3)), np.tile([0.0, 0.5, -1.2, 0.05], (101, 1))
    far = Flight("helix", time, zero, zero + 0.01, np.tile([0.06, 0.0, 0.0], (101, 1)), joints, "done", "")
    near = Flight("helix", time, zero, zero, np.tile([0.0, 0.005, 0.0], (101, 1)), joints, "done", "")
    rounds = [Round("crane@1", {"helix": far}, {}, gap_result(effect("backlash", "slew")), {}, 1.0)]
    rounds.append(Round("crane@2", {"helix": near}, {}, None, {}, 1.0))
    found = curves(write_story(tmp_path / "story.rrd", site.nominal().machine, rounds, "story"))
    np.testing.assert_allclose(found["/error/x/before"][1], 60.0)
    np.testing.assert_allclose(found["/error/y/after"][1], 5.0)
    assert len(found["/texts"][0]) == 3
    assert np.ptp(found["/texts"][0]) < 1.0
