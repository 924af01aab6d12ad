"""Lanes of a servo axis that run together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from servo_arms import arm_text, commands, drafted, logged, recording_of

from sysid.plant import compile_plant, nominal_plant
from sysid.plant.layout import AT, AXIS_WIDTH


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
