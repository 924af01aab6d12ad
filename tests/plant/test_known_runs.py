"""Free runs of servo axes that were asked for already are not made again, and are the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from servo_arms import arm_text, commands, drafted, logged, recording_of

from sysid.plant import compile_plant, known_runs, nominal_plant, servo_axis
from sysid.plant.known_runs import KnownRuns
from sysid.plant.layout import AT, AXIS_WIDTH


def test_lanes_that_were_run_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text, dt = arm_text(2, 1), 0.01
    machine, wanted = drafted(tmp_path, text), commands(2, 300, dt)
    recording, model = recording_of(wanted, logged(text, wanted, dt), dt, machine), compile_plant(nominal_plant(machine))
    thetas = np.repeat(model.theta[None], 4, axis=0)
    thetas[1:, AXIS_WIDTH + AT.link_mass_error] = 1.2, 1.0, 1.3
    thetas[1:, AT.stiffness_error] = 1.0, 0.9, 0.8
    made, whole = [0], servo_axis.drive_servo

    def counted(*inputs: Any) -> None:
        made[0] += len(inputs[0])
        whole(*inputs)

    monkeypatch.setattr(servo_axis, "drive_servo", counted)
    first = model.drive(thetas[:3], recording, "j0")
    assert made[0] == 3
    kept = first.copy()
    first[:] = 0.0  # what a caller does with its runs is its own affair
    again = model.drive(thetas[::-1], recording, "j0")
    assert made[0] == 4
    np.testing.assert_array_equal(again[:0:-1], kept)
    assert np.ptp(again, axis=0).max() > 1e-3
    model.drive(thetas, recording, "j1")
    assert made[0] == 8
    restarted = model.drive(thetas[3:], recording, "j0", restart_every=0.5)
    assert np.abs(restarted - again[:1]).max() > 1e-4
    assert made[0] == 9
    recording.derived.clear()
    np.testing.assert_array_equal(model.drive(thetas, recording, "j0"), again[::-1])
    assert made[0] == 13


@pytest.mark.parametrize("count", [1, 4, 9])
def test_lanes_beside_each_other_are_as_alone(tmp_path: Path, count: int) -> None:
    """With and without the steps of the described simulator, and with lanes of other masses between them."""
    text, dt = arm_text(2, 1), 0.01
    machine, wanted = drafted(tmp_path, text), commands(2, 300, dt)
    of_its_own = [replace(axis, servo=replace(axis.servo, step=0.0)) for axis in machine.axes]  # type: ignore[type-var]
    for each in (machine, replace(machine, axes=tuple(of_its_own))):
        model = compile_plant(nominal_plant(each))
        thetas = np.repeat(model.theta[None], count, axis=0)
        thetas[:, AT.stiffness_error] = np.linspace(0.6, 1.4, count)
        thetas[::2, AT.input_delay] = 0.013
        thetas[::3, AXIS_WIDTH + AT.link_mass_error] = 1.2
        thetas[1::2, AT.backlash_drive] = 0.02
        log = logged(text, wanted, dt)
        whole = model.drive(thetas, recording_of(wanted, log, dt, each), "j0")
        alone = [model.drive(theta[None], recording_of(wanted, log, dt, each), "j0")[0] for theta in thetas]
        np.testing.assert_array_equal(whole, alone)


def test_the_oldest_run_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(known_runs, "KEPT", 20)
    known, out = KnownRuns(10), np.empty(10)
    for value in (1.0, 2.0):
        known.keep(0, np.array([value]), np.full(10, value))
    assert known.read(0, np.array([1.0]), out)
    known.keep(0, np.array([3.0]), np.full(10, 3.0))
    assert [known.read(0, np.array([value]), out) for value in (1.0, 2.0, 3.0)] == [True, False, True]
    assert not known.read(1, np.array([1.0]), out)
    np.testing.assert_array_equal(out, 3.0)
