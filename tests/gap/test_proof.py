"""What gets a name on held-out recordings: what matters there, and once."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from plant_data import ROLES, arm, arm_inputs, dataset_of, measured, nominal, slide

from sysid.datasets.recording import Dataset
from sysid.gap import GapResult, find_gap, held_out, proof
from sysid.gap.candidates import Unknown, candidates_at
from sysid.gap.fit import Fit
from sysid.gap.held_out import comparisons_without, without_cheap_names
from sysid.gap.prepare.case import Stage
from sysid.gap.prepare.resolution import CoarseSensor
from sysid.gap.reasons import Reason
from sysid.gap.stage_intervals import interval_of, may_be_absent, simultaneous, with_intervals_of
from sysid.gap.stage_kind import FORCE, JOINT, LINKS, POSITION, SPEED
from sysid.gap.stage_model import StageFit
from sysid.gap.stage_result import StageResult
from sysid.gap.thresholds import Z
from sysid.machine import KnownEffect
from sysid.plant import compile_plant


def holds(found: GapResult, parameter: str, truth: float) -> bool:
    """Whether the interval of the first effect holds the truth."""
    low, high = found.effects[0].interval95[parameter]
    return bool(low <= truth <= high)


def test_a_scale_of_a_sensor_is_not_counted_twice() -> None:
    """The cylinder's sensor reads 0.6 % too much: its drive, which is read by the same sensor, has no gain error as well."""
    true = nominal(KnownEffect("sensor_scale", "boom.cylinder", {"scale": 1.006}))
    found = find_gap(dataset_of(true, 20.0, seed=5), nominal())
    assert [(effect.name, effect.target) for effect in found.effects] == [("sensor_scale", "boom.cylinder")]
    assert found.effects[0].parameters["scale"] == pytest.approx(1.006, abs=1e-4)
    assert holds(found, "scale", 1.006)
    assert found.ambiguous == ()
    for signal in ("boom.cylinder", "boom.joint"):
        assert found.stage_gap.after[signal] < 1.1 * found.stage_gap.noise_floor[signal], signal


@pytest.mark.slow
def test_a_scale_beside_a_gain_error_of_another_size_keeps_its_name() -> None:
    """The drive is 3 % too fast without the scale of its sensor, and 2 % with it."""
    true = nominal(
        KnownEffect("sensor_scale", "boom.cylinder", {"scale": 1.01}), KnownEffect("gain_error", "boom", {"ratio": 1.02})
    )
    found = find_gap(dataset_of(true, 40.0, seed=5), nominal())
    assert {(effect.name, effect.target) for effect in found.effects} == {
        ("sensor_scale", "boom.cylinder"),
        ("gain_error", "boom"),
    }


def test_a_scale_that_its_drive_contradicts_is_not_named() -> None:
    """A drive whose sensor shows the right speed has no gain error that exactly undoes a scale of that sensor.

    It is also what an owner has who identified the gain with that sensor; the drive cannot tell, so neither is named.
    """
    scale = KnownEffect("sensor_scale", "boom.cylinder", {"scale": 1.01})
    true = nominal(scale, KnownEffect("gain_error", "boom", {"ratio": 1.0 / 1.01}))
    found = find_gap(dataset_of(true, 20.0, seed=5), nominal())
    assert ("gain_error", "boom") not in {(effect.name, effect.target) for effect in found.effects}
    assert ("sensor_scale", "boom.cylinder") not in {(effect.name, effect.target) for effect in found.effects}
    (miss,) = (miss for miss in found.near_misses if (miss.name, miss.target) == ("sensor_scale", "boom.cylinder"))
    assert miss.lacks is Reason.REFUTED
    assert miss.parameters["scale"] == pytest.approx(1.01, abs=1e-3)


def test_a_small_value_that_everything_depends_on_gets_its_name() -> None:
    """A dead time that is 0.7 ms longer: hardly more than clocks are known by, and most of what a precise servo is off."""
    lag, machine = (
        KnownEffect("first_order_lag", "wrist", {"time_constant": 0.04}),
        replace(arm(), convention="read_before_written"),
    )
    plant = nominal(lag, KnownEffect("input_delay", "wrist", {"delay": 0.03}), machine=machine)
    true = nominal(lag, KnownEffect("input_delay", "wrist", {"delay": 0.0307}), machine=machine)
    found = find_gap(dataset_of(true, 20.0, seed=5), plant)
    assert [(effect.name, effect.target) for effect in found.effects] == [("input_delay", "wrist")]
    assert found.effects[0].parameters["delay"] == pytest.approx(0.0307, abs=1e-4)
    assert holds(found, "delay", 0.0307)


@pytest.mark.slow
def test_of_two_names_for_one_thing_the_simpler_one_is_taken() -> None:
    """While a slide moves, a load is a friction that differs by direction; the latter takes one number more to say so."""
    known = KnownEffect("coulomb_friction", "slide", {"force": 8.0})
    true = nominal(known, KnownEffect("load_bias", "slide", {"force": 3.0}), machine=slide())
    found = find_gap(dataset_of(true, 8.0, seed=5), nominal(known, machine=slide()))
    assert [effect.name for effect in found.effects] == ["load_bias"]
    assert found.effects[0].parameters["force"] == pytest.approx(3.0, abs=0.02)
    assert holds(found, "force", 3.0)
    assert found.ambiguous == ()
    after, floor = found.stage_gap.after["slide.command"], found.stage_gap.noise_floor["slide.command"]
    assert after < 1.1 * floor


def test_a_limit_that_the_held_out_recording_never_reaches_gets_its_name_from_the_others() -> None:
    """That recording neither proves nor refutes it; the share is what it closes where it shows."""
    true = nominal(KnownEffect("flow_saturation", "boom", {"limit": 0.6}))
    recordings = []
    for k, role in enumerate(ROLES):
        inputs = arm_inputs(f"run-{k + 1}", 15.0, 50 + k)
        if role == "held_out":
            table = inputs.table.copy()
            table["boom.command"] *= 0.5
            inputs = replace(inputs, table=table)
        recordings.append(measured(true, inputs, 50 + k))
    splits = {r.name: role for r, role in zip(recordings, ROLES, strict=True)}
    found = find_gap(Dataset.of(true.machine, recordings, splits), nominal())
    assert [(effect.name, effect.target) for effect in found.effects] == [("flow_saturation", "boom")]
    assert found.effects[0].gap_share > 0.5
    assert holds(found, "limit", 0.6)


def test_a_release_that_no_recording_shows_is_not_given() -> None:
    """Commands that jump past the release say nothing of it: the repaired plant has a value, the answer its interval alone."""
    true = nominal(KnownEffect("stiction", "boom", {"breakaway": 0.15, "release": 0.02}))
    found = find_gap(dataset_of(true, 20.0, seed=5), nominal())
    (effect,) = found.effects
    assert (effect.name, effect.undetermined) == ("stiction", ("release",))
    (entry,) = found.to_json()["effects"]
    assert list(entry["parameters"]) == list(entry["interval95"]) == ["breakaway"]
    low, high = entry["undetermined"]["release"]["interval95"]
    assert low <= 0.02 <= high


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "key"),
    [
        ({"breakaway": 0.15, "release": 0.05}, "breakaway"),
        ({"spool_breakaway": 0.15, "spool_release": 0.01}, "spool_breakaway"),
    ],
    ids=["seals", "spool"],
)
def test_seals_and_a_spool_that_stick_are_distinguished(hidden: dict[str, float | list[float]], key: str) -> None:
    """Seals stick behind the lag, a spool in front of it and of its overlaps, which differ."""
    known = [
        KnownEffect("valve_deadband", "boom", {"positive": 0.25, "negative": 0.05}),
        KnownEffect("first_order_lag", "boom", {"time_constant": 0.08}),
    ]
    found = find_gap(dataset_of(nominal(*known, KnownEffect("stiction", "boom", hidden)), 20.0, seed=5), nominal(*known))
    (effect,) = found.effects
    assert (effect.name, effect.target) == ("stiction", "boom")
    assert set(effect.parameters) == set(hidden)
    assert effect.parameters[key] == pytest.approx(0.15, abs=0.02)
    assert holds(found, key, 0.15)


@pytest.mark.slow
def test_the_damping_of_a_swing_is_given() -> None:
    """A secondary parameter that is known to a quarter, below a wrist that does not throw the tool."""
    servo = KnownEffect("first_order_lag", "wrist", {"time_constant": 0.15})
    true = nominal(servo, KnownEffect("gripper_sway", "tool", {"length": 0.2, "damping_ratio": 0.04}))
    found = find_gap(dataset_of(true, 60.0, seed=5), nominal(servo))
    (effect,) = found.effects
    assert effect.undetermined == ()
    assert effect.parameters["damping_ratio"] == pytest.approx(0.04, rel=0.25)


def test_a_name_beside_a_tie_and_an_adjusted_value_is_as_certain_as_it_is_alone() -> None:
    """Warm oil is named, a leak ties with a dead-band: the names alone have the oil, not the leak."""
    leak, oil, lag = (SimpleNamespace(label=label, unknowns=(0,)) for label in ("leak", "oil", "lag"))

    def stage(candidates: list[Any], values: list[float], limits: list[list[float]]) -> Stage:
        fit = Fit(tuple(candidates), (), np.array(values), np.empty(0))
        named = tuple(SimpleNamespace(candidate=c) for c in candidates if c is not lag)
        result = StageResult(None, named, (), fit, 2.0, 1.0, limits=np.array(limits))  # type: ignore[arg-type]
        return Stage(None, None, np.ones(1), np.empty(0), result)  # type: ignore[arg-type]

    whole = stage([leak, lag, oil], [1.0, 2.0, 3.0], [[0.0, 2.0], [1.0, 3.0], [1.0, 9.0]])
    found = with_intervals_of(whole, stage([oil], [3.2], [[3.1, 3.3]]))
    assert found.found.limits is not None
    assert found.found.limits.tolist() == [[0.0, 2.0], [1.0, 3.0], [3.0, 3.3]]


@pytest.mark.parametrize("accumulates", [True, False])
def test_where_errors_accumulate_a_name_is_tested_without_what_is_adjusted_beside_it(accumulates: bool) -> None:
    """The set that won the comparison against the set without the name, not the chosen model with six effects."""

    def result(theta: float, less: float, alone: Any = None, beside: Any = None) -> Any:
        decision = SimpleNamespace(accumulates=accumulates)
        fitted = SimpleNamespace(decision=decision, dropped={"rate": vector(less)}, beside=beside)
        return SimpleNamespace(fit=vector(theta), stage_fit=fitted, names_alone=alone, accumulates=accumulates)

    def vector(value: float) -> Any:
        return SimpleNamespace(theta=np.array([value]))

    def pairs(found: Any) -> list[tuple[float, float]]:
        stage: Any = SimpleNamespace(found=found, nominal=vector(0.0), problem=_problem(accumulates))
        return [(less.theta.item(), model.theta.item()) for less, model in comparisons_without(stage, "rate")]

    if not accumulates:
        assert pairs(result(3.0, 4.0, alone=result(1.0, 2.0))) == [(0.0, 3.0)]
        return
    assert pairs(result(3.0, 4.0, alone=result(1.0, 2.0))) == [(2.0, 1.0)]
    assert pairs(result(3.0, 4.0)) == [(4.0, 3.0)]
    beside = vector(5.0), {"rate": vector(6.0)}
    assert pairs(result(3.0, 4.0, alone=result(1.0, 2.0), beside=beside)) == [(2.0, 1.0), (6.0, 5.0)]
    assert pairs(result(3.0, 4.0, beside=(vector(5.0), {"delay": vector(6.0)}))) == [(4.0, 3.0)]


@pytest.mark.parametrize(
    ("alone", "extended", "kept"),
    [
        ((17.0, 12.0), None, False),
        ((17.0, 5.0), None, True),
        ((17.0, 12.0), (17.0, 5.0), True),  # what the owner has not fitted hides it
        ((17.0, 12.0), (14.0, 9.0), False),
    ],
)
def test_one_comparison_on_recordings_left_out_has_to_be_worth_the_price(
    alone: tuple[float, float], extended: tuple[float, float] | None, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scores of the sets without and with the name, in noise floors; a vector is its own score here."""
    monkeypatch.setattr(held_out, "cross_validated_error", lambda stage, model: float(model.theta[0]))

    def vector(value: float) -> Any:
        return SimpleNamespace(theta=np.array([value]))

    class Unnamed(SimpleNamespace):
        def without_names(self, lost: dict[str, str]) -> Unnamed:
            return Unnamed(accumulates=True, exact=False, lost=lost)

    beside = (vector(extended[1]), {"oil(boom)": vector(extended[0])}) if extended is not None else None
    model: Any = Unnamed(accumulates=True, exact=False, lost={})
    unused: Any = None
    fitted = StageFit((), model, {"oil(boom)": vector(alone[0])}, unused, unused, beside=beside)
    name: Any = SimpleNamespace(candidate=SimpleNamespace(label="oil(boom)", target="boom"))
    result = StageResult(unused, (name,), (), vector(alone[1]), 1.0, 1.0, stage_fit=fitted)
    problem: Any = SimpleNamespace(stage="command", target="boom", kind=SPEED)
    stage = Stage(problem, SimpleNamespace(seen=(), held_out=()), np.ones(1), np.array([20.0]), result)  # type: ignore[arg-type]
    found = without_cheap_names(stage)
    assert bool(found.found.named) is kept
    assert found.found.stage_fit is not None
    lacks = (
        {}
        if kept
        else {"oil(boom)": "on recordings left out of the fit it reduces the error by too little compared with what remains"}
    )
    assert found.found.stage_fit.decision.lost == lacks  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("before", "after", "better"),
    [
        ([20.0, 20.0], [19.0, 20.0], True),
        ([20.0, 20.0], [15.0, 21.0], True),  # the stage better, one signal worse by less than a tenth
        ([20.0, 20.0], [15.0, 23.0], False),
        ([20.0, 1.0], [20.0, 1.05], True),  # not excited, and within the noise floor
        ([20.0, 20.0], [20.0, 20.5], False),  # not excited, but worse
    ],
)
def test_no_signal_gets_worse_on_held_out_recordings(
    before: list[float], after: list[float], better: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(held_out, "stage_rmse", lambda _problem, theta, _recordings: np.array(theta))
    monkeypatch.setattr(held_out, "is_excited", lambda *_: False)
    found = SimpleNamespace(fit=SimpleNamespace(theta=after))
    stage: Any = SimpleNamespace(
        problem=None, split=SimpleNamespace(held_out=()), theta=before, found=found, sigma=np.array([1.0, 1.0])
    )
    assert held_out.is_better(stage) is better


@pytest.mark.parametrize(("low", "absent"), [(1.5, False), (1.2, True), (0.9, True)])
def test_an_interval_that_reaches_into_the_region_of_equivalence_may_be_absent(low: float, absent: bool) -> None:
    """A unit of the parameter moves the output by one noise floor: the region reaches to 1.46."""
    candidate: Any = SimpleNamespace(label="gain", unknowns=(Unknown("ratio", (0,), (0.0, 9.0), 1.0, 0.01),))
    model = SimpleNamespace(
        labels={"gain"}, left=1.0, response=np.ones(1), rows_of=lambda _: slice(0, 1), values_of=lambda _: np.array([2.0])
    )
    fitted = SimpleNamespace(decision=SimpleNamespace(model=model))
    result: Any = SimpleNamespace(fit=SimpleNamespace(rows_of=lambda _: slice(0, 1)), stage_fit=fitted)
    assert may_be_absent(result, candidate, np.array([[low, 3.0]])) is absent


@pytest.mark.parametrize(("high", "absent"), [(100.0, False), (900.0, True), (1000.0, True)])
def test_an_effect_that_is_absent_at_infinity_may_be_absent_by_its_inverse(high: float, absent: bool) -> None:
    """A frequency of 40 that may be 900 is as good as none, although 100 Hz remain to the value at which it is absent."""
    candidate: Any = SimpleNamespace(label="oil", unknowns=(Unknown("frequency", (0,), (1.0, 1e3), 1e3, 0.3, reciprocal=True),))
    model = SimpleNamespace(
        labels={"oil"}, left=1.0, response=np.array([0.1]), rows_of=lambda _: slice(0, 1), values_of=lambda _: np.array([40.0])
    )
    fitted = SimpleNamespace(decision=SimpleNamespace(model=model))
    result: Any = SimpleNamespace(fit=SimpleNamespace(rows_of=lambda _: slice(0, 1)), stage_fit=fitted)
    assert may_be_absent(result, candidate, np.array([[20.0, high]])) is absent


@pytest.mark.parametrize(("deviation", "high"), [(2.0, 1.0 / (1.0 / 40.0 - Z * 2.0 / 1600.0)), (30.0, np.inf)])
def test_the_interval_of_a_value_that_may_be_infinite_is_that_of_its_inverse(deviation: float, high: float) -> None:
    unknowns = (
        Unknown("frequency", (0,), (1.0, 1e3), 1e3, 0.3, reciprocal=True),
        Unknown("delay", (1,), (0.0, 1.0), 0.0, 0.01),
    )
    model: Any = SimpleNamespace(
        unknowns=unknowns, values=np.array([40.0, 0.1]), covariance=np.diag([deviation**2, 0.01**2]), confounded=np.zeros(2)
    )
    found = interval_of(model, exact=True, spread=None)
    assert found[0] == pytest.approx([1.0 / (1.0 / 40.0 + Z * deviation / 1600.0), high])
    assert found[1] == pytest.approx([0.1 - 0.01 * Z, 0.1 + 0.01 * Z])


@pytest.mark.parametrize(
    ("share", "absent", "refused"),
    [(0.5, False, None), (0.5, True, Reason.UNCERTAIN), (0.005, False, Reason.LOST)],
)
def test_what_refuses_a_name(share: float, absent: bool, refused: Reason | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(proof, "may_be_absent", lambda *_: absent)
    monkeypatch.setattr(proof, "_least_share", lambda _: 0.01)
    assert proof._refusal(_stage(True), _kept(), np.empty(0), share) == refused


@pytest.mark.parametrize(
    ("gains", "refused"),
    [
        ([2.0, 1.9], None),
        ([5.0, 4.9, -5.0, 4.8, -4.9, 0.4], Reason.LOST),  # 5.2 ± 10: two biases that cancel
        ([5.0, 5.0, 5.0, -1.0, 4.0, 2.0], None),  # 20 ± 5
        ([0.1, 0.1], Reason.LOST),  # significant, and of no size
        ([-4.0, -5.0], Reason.LOST),
    ],
)
def test_blocks_have_to_be_predicted_clearly_better_with_an_effect_where_errors_do_not_accumulate(
    gains: list[float], refused: Reason | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not those of a force: the discrepancy replaces friction and a payload, whose values it does not take."""
    monkeypatch.setattr(proof, "may_be_absent", lambda *_: False)
    monkeypatch.setattr(proof, "_least_share", lambda _: 0.01)
    whole, less = (SimpleNamespace(predictive=np.array(each)) for each in (gains, [0.0] * len(gains)))
    for kind, expected in ((JOINT, refused), (FORCE, None), (LINKS, None)):
        stage = _stage(False)
        stage.found.problem.kind = kind
        stage.found.stage_fit = SimpleNamespace(decision=SimpleNamespace(model=whole), dropped={"leak": less})
        assert proof._refusal(stage, _kept(), np.empty(0), 0.5) == expected


def _problem(integrates: bool) -> SimpleNamespace:
    return SimpleNamespace(kind=SPEED if integrates else POSITION)


def _stage(integrates: bool, accumulates: bool = False) -> Any:
    result = SimpleNamespace(accumulates=accumulates, names_alone=None, problem=_problem(integrates))
    return SimpleNamespace(found=result)


def _kept() -> Any:
    return SimpleNamespace(candidate=SimpleNamespace(label="leak"))


@pytest.mark.parametrize("uncertain", [True, False])
def test_a_named_limit_of_the_pump_keeps_its_value_where_another_drive_does_not_prove_it(
    uncertain: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other drive has a name that the proof refuses, or only adjusts the limit."""
    plant, named = nominal(), KnownEffect("pump_flow_limit", "machine", {"limit": 1.8})
    pump = next(
        c
        for c in candidates_at(plant, compile_plant(plant).theta, ("command",), ("boom", "machine"))
        if c.effect.name == named.name
    )
    outcome = proof.ProofOutcome(plant.with_effect(named))
    outcome.named.append(proof.NamedEffect(named.name, "machine", {"limit": 1.8}, {"limit": (1.7, 1.9)}, 0.9))
    monkeypatch.setattr(proof, "_refusal", lambda *_: Reason.UNCERTAIN)
    monkeypatch.setattr(proof, "_share", lambda *_: 0.5)
    monkeypatch.setattr(proof, "_uncertainty", lambda *_: SimpleNamespace(places=()))
    kept: Any = SimpleNamespace(candidate=pump, ties=())
    unused: Any = None
    fit = Fit((pump,), pump.unknowns, np.array([1.4]), np.empty(0))
    fitted = StageFit((), SimpleNamespace(model=None), {}, unused, unused)  # type: ignore[arg-type]
    result = StageResult(
        unused,
        (kept,) if uncertain else (),
        () if uncertain else (pump,),
        fit,
        1.0,
        1.0,
        stage_fit=fitted,
        limits=np.ones((1, 2)),
    )
    problem: Any = SimpleNamespace(stage="command", target="boom")
    stage = Stage(problem, unused, np.ones(1), np.empty(0), result)
    assert proof._accept(stage, outcome) == {}
    assert outcome.repaired.effect(named.name, "machine") == named


def test_steps_of_a_sensor_are_compared_with_the_plant_that_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search on readings in coarse steps may find effects that leave more; these are not in the plant."""
    monkeypatch.setattr(proof, "problem_floor", lambda *_: np.array([0.02]))
    monkeypatch.setattr(proof, "stage_rmse", lambda _problem, theta, _recordings: np.array([theta]))
    coarse = CoarseSensor("stick.cylinder", 6.0, (5.99, 6.01), 0.02)
    case: Any = SimpleNamespace(noise={"stick.cylinder": 1.73}, seed=0)

    def share(nominal: float, fitted: float) -> float:
        problem, split = SimpleNamespace(signals=("stick.cylinder",)), SimpleNamespace(fit=(), held_out=())
        found = SimpleNamespace(fit=SimpleNamespace(theta=fitted))
        stage: Any = SimpleNamespace(problem=problem, split=split, theta=nominal, found=found, sigma=np.array([1.73]))
        return proof._explained(case, stage, coarse)

    assert share(2.6, 3.7) == share(3.7, 2.6) == pytest.approx((1.73 - 0.02) / (2.6 - 0.02))


def test_the_interval_of_a_vector_holds_for_all_components_together() -> None:
    """The largest of three independent normal errors exceeds 1.96 standard deviations in 14 % of the cases."""
    rng = np.random.default_rng(3)
    limits = np.array([[-1.959964, 1.959964]] * 3)
    (low, high) = simultaneous(np.zeros(3), limits).T
    errors = rng.normal(size=(4000, 3))
    assert 0.94 < np.mean(((low < errors) & (errors < high)).all(axis=1)) < 0.96
    assert simultaneous(np.zeros(1), limits[:1]) == pytest.approx(limits[:1], rel=1e-6)
