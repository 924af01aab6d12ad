"""Error of a servo at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sagging_servo import AXES, DELAY, LAG, NOISE, Servos, machine_files, recording

from sysid.datasets.recording import Recording
from sysid.gap.problem import drive_problem
from sysid.gap.servo.sag import StaticError, static_error
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import compile_plant, nominal_plant


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
