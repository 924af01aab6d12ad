"""The resonance of a drive from force and motion, and none where the drive is rigid."""

from __future__ import annotations

import numpy as np
import pytest
from force_axis import MASS, acting, linear_motion, machine, multisine, recording

from sysid.datasets import Recording
from sysid.gap.prepare.drives import drive_resonance
from sysid.plant.force import ForceFilter

RATE = 1000.0
AXIS = machine().axis("x")
BAND = ForceFilter(position_hz=125.0, force_hz=50.0, delay=0.5)


def drive(antiresonance_hz: float, load: float, friction: float = 0.0) -> Recording:
    """A motor with a load behind a spring; ``friction``: dry friction [N] that the force overcomes besides."""
    force = multisine(25.0, 50.0)
    position = linear_motion(force, RATE, load * (2.0 * np.pi * antiresonance_hz) ** 2, load, damping=0.02 * load * 100.0)
    total = acting(force, position, RATE) + friction * np.sign(np.gradient(position))
    return recording(total, position, noise=(0.05, 1e-7))


@pytest.mark.parametrize(("antiresonance_hz", "load"), [(8.0, 1.2), (15.0, 0.6), (25.0, 1.0)])
def test_both_frequencies_and_the_ratio_of_inertias(antiresonance_hz: float, load: float) -> None:
    found = drive_resonance([drive(antiresonance_hz, load)], AXIS, BAND)
    assert found is not None
    ratio = load / (MASS - load)
    assert found.antiresonance_hz == pytest.approx(antiresonance_hz, rel=0.01)
    assert found.resonance_hz == pytest.approx(antiresonance_hz * np.sqrt(1.0 + ratio), rel=0.02)
    assert found.inertia_ratio == pytest.approx(ratio, rel=0.05)
    assert "load" in str(found)


def test_dry_friction_does_not_hide_it() -> None:
    found = drive_resonance([drive(15.0, 1.2, friction=3.0)], AXIS, BAND)
    assert found is not None
    assert found.antiresonance_hz == pytest.approx(15.0, rel=0.03)


def test_a_rigid_drive_has_none() -> None:
    force = multisine(25.0, 50.0)
    position = linear_motion(force, RATE)
    friction = 3.0 * np.sign(np.gradient(position))
    part = recording(acting(force, position, RATE) + friction, position, noise=(0.05, 1e-7))
    assert drive_resonance([part], AXIS, BAND) is None


def test_slow_motion_and_short_runs_have_none() -> None:
    force = multisine(25.0, 2.0)
    slow = recording(force, linear_motion(force, RATE), noise=(0.05, 1e-6))
    assert drive_resonance([slow], AXIS, ForceFilter()) is None
    short = drive(15.0, 1.2)
    cut = Recording("cut", short.table.iloc[:300], RATE)
    assert drive_resonance([cut], AXIS, BAND) is None


def test_a_weight_has_none() -> None:
    """Its torque grows with the position, like that of a load behind a soft spring."""
    force = multisine(25.0, 50.0)
    position = linear_motion(force, RATE)
    part = recording(force, position, noise=(0.05, 1e-7))  # with the spring and the damper that hold the mass in place
    assert drive_resonance([part], AXIS, BAND) is None
