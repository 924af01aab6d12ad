"""A step of a force axis with dry friction: the motion under a held force, whatever the length of a sample."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.machine import KnownEffect
from sysid.plant import Plant, nominal_plant
from sysid.plant.stepper import Stepper
from sysid.testing.probe import probe_machine

MASS = 2.0
FRICTIONS = {
    "coulomb_friction": {"positive": 1.0, "negative": 1.6},
    "stribeck_friction": {"static_force": 1.4, "coulomb_force": 1.4, "stribeck_velocity": 0.01},
}
#: Force against motion in either direction [N]; a Stribeck law with one force is a Coulomb law.
LIMITS = {"coulomb_friction": {1.0: 1.0, -1.0: 1.6}, "stribeck_friction": {1.0: 1.4, -1.0: 1.4}}


def plant_of(name: str) -> Plant:
    return nominal_plant(probe_machine()).with_effect(KnownEffect(name, "slide", FRICTIONS[name]))


def run(plant: Plant, rate_hz: float, forces: list[float], each: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and forces' times: each force is held for ``each`` samples."""
    stepper = Stepper(plant, rate_hz)
    stepper.reset([0.0, 0.2, 0.0, 0.0])
    found = []
    for force in forces:
        for _ in range(each):
            state = stepper.step([0.0, 0.0, force, 0.0])
        found.append(state.joints[0, 2])
    return np.array(found), np.arange(1, len(forces) + 1) * each / rate_hz


def exact(plant: Plant, forces: list[float], held: float) -> np.ndarray:
    """Positions at the ends of held forces: parabolas between stops, by hand."""
    limits = LIMITS[plant.effects[0].name]
    x = v = 0.0
    found = []
    for force in forces:
        left = held
        while left > 1e-12:
            side = float(np.sign(v)) or float(np.sign(force))
            a = (force - side * limits[side]) / MASS
            if v == 0.0 and side * a <= 0.0:
                break
            stops = -v / a if v * a < 0.0 else np.inf
            t = min(left, stops)
            x, v = x + v * t + 0.5 * a * t * t, 0.0 if stops <= left else v + a * t
            left -= t
        found.append(x)
    return np.array(found)


@pytest.mark.parametrize("name", FRICTIONS)
def test_reversals_within_a_sample(name: str) -> None:
    rng = np.random.default_rng(3)
    forces = [float(f) for f in rng.uniform(-6.0, 6.0, 200)]
    plant = plant_of(name)
    for samples in (1, 4):
        found, times = run(plant, samples / 0.05, forces, samples)
        assert times[-1] == pytest.approx(10.0)
        np.testing.assert_allclose(found, exact(plant, forces, 0.05), rtol=0.0, atol=1e-9)
    assert np.ptp(found) > 0.1
