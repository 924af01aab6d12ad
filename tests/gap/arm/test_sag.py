"""Sag of a servo: whether its gravity load is known, its error at rest, and sets of effects on models made by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from compared_models import decided
from sagging_servo import AXES, DELAY, LAG, NOISE, Servos, machine_files, recording

from sysid.datasets.recording import Recording
from sysid.gap.arm.sag import StaticError, fewest_sets, load_known, static_error
from sysid.gap.candidates import Candidate, Scales, candidates_at
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.problem import drive_problem
from sysid.gap.reasons import Reason
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import compile_plant, nominal_plant

EVERY = dict.fromkeys(AXES, True)


@pytest.mark.parametrize(
    ("masses", "known"),
    [(True, EVERY), (False, {**dict.fromkeys(AXES, False), "yaw": True}), (None, dict.fromkeys(AXES, False))],
)
def test_masses_or_a_vertical_axis_make_the_load_known(masses: bool | None, known: dict[str, bool]) -> None:
    machine = machine_from_files(machine_files(masses), "servos")
    motion = recording(Servos(), "take", 1, 10.0)
    assert {axis: load_known(machine, axis, [motion]) for axis in AXES} == known


def test_a_slide_carries_no_weight_where_it_is_horizontal() -> None:
    files = machine_files(False)
    for direction, known in (("0 0 1", False), ("1 0 0", True)):
        urdf = files["arm.urdf"].replace('"yaw_joint" type="revolute"', '"yaw_joint" type="prismatic"', 1)
        urdf = urdf.replace('<axis xyz="0 0 1"/>', f'<axis xyz="{direction}"/>', 1)
        machine = machine_from_files({**files, "arm.urdf": urdf}, "servos")
        assert load_known(machine, "yaw", [recording(Servos(), "take", 1, 10.0)]) == known


def test_without_a_recorded_posture_the_load_is_not_known() -> None:
    assert not load_known(machine_from_files(machine_files(False), "servos"), "yaw", [])


def error_of(axis: str, recordings: list[Recording]) -> StaticError | None:
    """The error at rest beside the dead time and the lag of the servos."""
    machine = machine_from_files(machine_files(None), "servos")
    plant = nominal_plant(machine)
    for name in AXES:
        plant = plant.with_effect(KnownEffect("input_delay", name, {"delay": DELAY}))
        plant = plant.with_effect(KnownEffect("first_order_lag", name, {"time_constant": LAG}))
    model = compile_plant(plant)
    return static_error(drive_problem(model, machine.axis(axis)), machine, model.theta, recordings, 2.0 * NOISE)


def takes(servos: Servos) -> list[Recording]:
    return [recording(servos, f"take-{k}", k) for k in range(2)]


def test_sag_is_an_error_at_rest_that_depends_on_the_posture() -> None:
    found = error_of("shoulder", takes(Servos(compliance={"shoulder": 0.1})))
    assert found is not None
    assert found.by_posture
    assert found.holds > 20
    assert 0.03 < found.rms < 0.09  # up to 0.64 N·m


def test_a_bias_does_not_depend_on_the_posture() -> None:
    found = error_of("yaw", takes(Servos(bias={"yaw": 0.01})))
    assert found is not None
    assert found.rms == pytest.approx(0.01, rel=0.1)
    assert not found.by_posture


@pytest.mark.parametrize("axis", AXES)
def test_a_servo_that_reaches_its_setpoint_has_none(axis: str) -> None:
    assert error_of(axis, takes(Servos())) is None


def test_what_has_the_sign_of_the_motion_is_friction() -> None:
    """The joint stops short of the setpoint by 10 mrad, from either side."""

    def stopped(take: Recording) -> Recording:
        command = take.values("yaw.command")
        moved = np.sign(np.diff(command, prepend=command[0]))
        last = np.maximum.accumulate(np.where(moved != 0.0, np.arange(len(moved)), 0))
        return replace(take, table=take.table.assign(**{"yaw.joint": take.values("yaw.joint") - 0.01 * moved[last]}))

    assert error_of("yaw", [stopped(take) for take in takes(Servos())]) is None


def test_motion_without_holds_does_not_show_it() -> None:
    time = np.arange(2000) / 50.0
    take = takes(Servos(bias={"yaw": 0.01}))[0]
    moving = replace(take, table=take.table.iloc[:2000].assign(**{"yaw.command": np.sin(time)}).reset_index(drop=True))
    assert error_of("yaw", [moving]) is None


PLANT = nominal_plant(machine_from_files(machine_files(True), "servos"))
TARGETS = ("shoulder", "shoulder.joint")
OFFERED = candidates_at(PLANT, PLANT.vector(), "command", TARGETS, Scales(loads={"shoulder": 0.5}))
SAG, BIAS, SCALE, SECOND_LAG, DEAD_TIME = (
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
WHOLE = model((SECOND_LAG, DEAD_TIME, SAG, BIAS), 30.0)


def test_what_remains_within_a_tenth_needs_no_effect() -> None:
    (found,) = fewest_sets(WHOLE, OFFERED, refit_of(LEFT))
    assert names(found) == {"second_order_lag", "input_delay", "joint_compliance"}


def test_the_effect_that_leaves_least_goes_first() -> None:
    """Each could go alone, both cannot."""
    left = {**LEFT, frozenset({"second_order_lag", "input_delay", "sensor_bias"}): 30.5}
    found = fewest_sets(WHOLE, OFFERED, refit_of(left))
    assert [names(f) & {"joint_compliance", "sensor_bias"} for f in found] == [{"sensor_bias"}, {"joint_compliance"}]


def test_near_the_noise_floor_the_floor_counts() -> None:
    """Below the noise floor nothing has to be explained."""
    (found,) = fewest_sets(model((SAG,), 0.2), OFFERED, lambda cs, _: model(cs, 1.05))
    assert names(found) == set()


@pytest.mark.parametrize(("bias", "tied"), [(60.0, False), (32.0, True)])
def test_sag_ties_with_a_bias_that_explains_as_much(bias: float, tied: bool) -> None:
    left = {**LEFT, frozenset({"second_order_lag", "input_delay", "sensor_bias"}): bias}
    refit = refit_of(left)
    found = decided(
        [model((), NOTHING), WHOLE],
        [c.label for c in OFFERED],
        integrates=False,
        smaller=lambda f, c: refit([d for d in f.candidates if d is not c], f),
        fewest=lambda f: fewest_sets(f, OFFERED, refit),
    )
    assert names(found.model) == {"second_order_lag", "input_delay", "joint_compliance"}
    assert (SAG in found.named) == (not tied)
    assert found.tied == (((SAG, BIAS),) if tied else ())
    assert all(near.lacks == Reason.REPLACED for near in found.near_misses if near.candidate is SAG)


def test_the_effects_that_are_worth_their_price_are_named() -> None:
    """Three effects would have to leave 400/√125 = 36 noise floors; two of them leave 45 of at most 80."""
    left = {
        frozenset({"second_order_lag", "input_delay", "joint_compliance"}): 40.0,
        frozenset({"second_order_lag", "joint_compliance"}): 45.0,
    }
    refit = refit_of(left)
    found = decided(
        [model((), NOTHING), model((SECOND_LAG, DEAD_TIME, SAG), 40.0)],
        [c.label for c in OFFERED],
        integrates=False,
        smaller=lambda f, c: refit([d for d in f.candidates if d is not c], f),
        fewest=lambda f: fewest_sets(f, OFFERED, refit),
    )
    assert set(found.named) == {SECOND_LAG, SAG}
    assert {near.candidate.effect.name: near.lacks for near in found.near_misses} == {"input_delay": Reason.LITTLE}
