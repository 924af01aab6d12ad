"""Sets of effects of a servo whose formulas are wrong, on models made by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from sagging_servo import machine_files

from sysid.gap.candidates import Candidate, Scales, candidates_at
from sysid.gap.decision import LITTLE, REPLACED, decide
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.servo.sag import fewest_sets
from sysid.gap.thresholds import EXPLAINED
from sysid.machine import machine_from_files
from sysid.plant import nominal_plant

PLANT = nominal_plant(machine_from_files(machine_files(True), "servos"))
TARGETS = ("shoulder", "shoulder.joint")
OFFERED = candidates_at(PLANT, PLANT.vector(), "command", TARGETS, Scales(loads={"shoulder": 0.5}))
SAG, BIAS, SCALE, LAG, DELAY = (
    next(c for c in OFFERED if c.effect.name == name)
    for name in ("joint_compliance", "sensor_bias", "sensor_scale", "second_order_lag", "input_delay")
)
BLOCKS = 20
#: What the model without effects leaves, in noise floors.
NOTHING = 400.0


def model(candidates: Sequence[Candidate], left: float) -> ModelFit:
    """A model whose values are certain; one that leaves more predicts worse."""
    unknowns = tuple(u for c in candidates for u in c.unknowns)
    k = len(unknowns)
    blocks = np.full(BLOCKS, -left / 10.0)
    return ModelFit(
        tuple(candidates), unknowns, np.array([u.nominal + 0.1 for u in unknowns]), PLANT.vector(), 1e-12 * np.eye(k),
        np.zeros(k), float(blocks.sum()), blocks, 1.0, np.full(k, 1e6), left,
    )  # fmt: skip


def refit_of(left: dict[frozenset[str], float]) -> Callable[[Sequence[Candidate], ModelFit], ModelFit]:
    """What sets of effects leave; sets that are not listed leave 300."""
    return lambda candidates, _: model(candidates, left.get(frozenset(c.effect.name for c in candidates), 300.0))


def names(fit: ModelFit) -> set[str]:
    return {c.effect.name for c in fit.candidates}


LEFT = {
    frozenset({"second_order_lag", "input_delay", "joint_compliance", "sensor_bias"}): 30.0,
    frozenset({"second_order_lag", "input_delay", "joint_compliance"}): 31.0,
    frozenset({"second_order_lag", "input_delay", "sensor_bias"}): 60.0,
}
WHOLE = model((LAG, DELAY, SAG, BIAS), 30.0)


def test_what_remains_within_a_tenth_needs_no_effect() -> None:
    (found,) = fewest_sets(WHOLE, OFFERED, refit_of(LEFT), EXPLAINED)
    assert names(found) == {"second_order_lag", "input_delay", "joint_compliance"}


def test_the_effect_that_leaves_least_goes_first() -> None:
    """Each could go alone, both cannot."""
    left = {**LEFT, frozenset({"second_order_lag", "input_delay", "sensor_bias"}): 30.5}
    found = fewest_sets(WHOLE, OFFERED, refit_of(left), EXPLAINED)
    assert [names(f) & {"joint_compliance", "sensor_bias"} for f in found] == [{"sensor_bias"}, {"joint_compliance"}]


def test_near_the_noise_floor_the_floor_counts() -> None:
    """Below the noise floor nothing has to be explained."""
    (found,) = fewest_sets(model((SAG,), 0.2), OFFERED, lambda cs, _: model(cs, 1.05), EXPLAINED)
    assert names(found) == set()


@pytest.mark.parametrize(("bias", "tied"), [(60.0, False), (32.0, True)])
def test_sag_ties_with_a_bias_that_explains_as_much(bias: float, tied: bool) -> None:
    left = {**LEFT, frozenset({"second_order_lag", "input_delay", "sensor_bias"}): bias}
    refit = refit_of(left)
    found = decide(
        [model((), NOTHING), WHOLE],
        [c.label for c in OFFERED],
        integrates=False,
        without=lambda f, c: refit([d for d in f.candidates if d is not c], f),
        fewest=lambda f: fewest_sets(f, OFFERED, refit, EXPLAINED),
    )
    assert names(found.model) == {"second_order_lag", "input_delay", "joint_compliance"}
    assert (SAG in found.named) == (not tied)
    assert found.tied == (((SAG, BIAS),) if tied else ())
    assert all(near.lacks == REPLACED for near in found.near_misses if near.candidate is SAG)


def test_the_effects_that_are_worth_their_price_are_named() -> None:
    """Three effects would have to leave 400/√125 = 36 noise floors; two of them leave 45 of at most 80."""
    left = {
        frozenset({"second_order_lag", "input_delay", "joint_compliance"}): 40.0,
        frozenset({"second_order_lag", "joint_compliance"}): 45.0,
    }
    refit = refit_of(left)
    found = decide(
        [model((), NOTHING), model((LAG, DELAY, SAG), 40.0)],
        [c.label for c in OFFERED],
        integrates=False,
        without=lambda f, c: refit([d for d in f.candidates if d is not c], f),
        fewest=lambda f: fewest_sets(f, OFFERED, refit, EXPLAINED),
    )
    assert set(found.named) == {LAG, SAG}
    assert {near.candidate.effect.name: near.lacks for near in found.near_misses} == {"input_delay": LITTLE}
