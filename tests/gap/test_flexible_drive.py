"""A load behind a spring is named where the force responds like one, beside friction, and not where something else bends it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from force_axis import MASS, acting, linear_motion, machine, multisine, recording
from plant_data import ROLES
from scipy import signal

from sysid.datasets import Dataset, Recording
from sysid.gap import GapResult, find_gap
from sysid.gap.prepare.drives import drive_resonance
from sysid.plant import nominal_plant
from sysid.plant.force import ForceFilter
from sysid.plant.force_band import force_filter

Array = npt.NDArray[np.float64]
RATE = 1000.0
ANTIRESONANCE, LOAD, DRY = 12.0, 1.2, 4.0
#: Of force [N] and position [m].
NOISE = 0.05, 1e-6


def pushed(seed: int, load: float, distort: Callable[[Array], Array] = lambda force: force) -> Recording:
    """A motor with a load behind a spring (or a rigid mass), dry friction of the motor, and a distorted log of the force."""
    force = multisine(10.0, 40.0, seed=seed)
    omega = 2.0 * np.pi * ANTIRESONANCE
    position = linear_motion(force, RATE, load * omega**2, load, damping=2.0 * 0.04 * omega * load)
    friction = DRY * np.sign(np.gradient(position))
    return recording(distort(acting(force, position, RATE) + friction), position, noise=NOISE, seed=seed)


def found(load: float, distort: Callable[[Array], Array] = lambda force: force) -> GapResult:
    recordings = [pushed(k, load, distort) for k in range(len(ROLES))]
    names = [f"run-{k}" for k in range(len(ROLES))]
    named = [Recording(name, r.table, RATE) for name, r in zip(names, recordings, strict=True)]
    axis = replace(machine(RATE), noise={"x.command": NOISE[0], "x.joint": NOISE[1]})
    return find_gap(Dataset.of(axis, named, dict(zip(names, ROLES, strict=True))), nominal_plant(axis))


@pytest.mark.slow
def test_named_with_its_values_beside_dry_friction() -> None:
    by_name = {effect.name: effect for effect in found(LOAD).effects}
    assert set(by_name) == {"flexible_drive", "coulomb_friction"}
    drive = by_name["flexible_drive"].parameters
    assert drive["frequency"] == pytest.approx(ANTIRESONANCE, rel=0.01)
    assert drive["inertia_ratio"] == pytest.approx(LOAD / (MASS - LOAD), rel=0.03)
    assert by_name["coulomb_friction"].parameters["force"] == pytest.approx(DRY, rel=0.05)


@pytest.mark.slow
def test_no_candidate_of_a_rigid_drive() -> None:
    result = found(0.0)
    assert {effect.name for effect in result.effects} == {"coulomb_friction"}
    assert not [item for item in (*result.near_misses, *result.excitation) if item.name == "flexible_drive"]


def low_pass(values: Array, hz: float, order: int) -> Array:
    return np.asarray(signal.lfilter(*signal.butter(order, hz, fs=RATE), values))


def resonant_sensor(values: Array) -> Array:
    """A sensor on an elastic mount, whose reading is largest at 25 Hz."""
    omega = 2.0 * np.pi * 25.0
    return np.asarray(signal.lfilter(*signal.bilinear([1.0], [1.0 / omega**2, 0.2 / omega, 1.0], RATE), values))


def notched(values: Array) -> Array:
    """Behind a notch filter of a controller."""
    return np.asarray(signal.lfilter(*signal.iirnotch(18.0, 3.0, fs=RATE), values))


#: Distortions of force and position of a rigid drive, each of which changes the response of force to motion coherently.
DISTORTED: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "nothing": (lambda f: f, lambda x: x),
    "force behind a lag": (lambda f: low_pass(f, 40.0, 1), lambda x: x),
    "force behind a second-order filter": (lambda f: low_pass(f, 20.0, 2), lambda x: x),
    "force behind a notch": (notched, lambda x: x),
    "force five samples late": (lambda f: np.roll(f, 5), lambda x: x),
    "position behind a lag": (lambda f: f, lambda x: low_pass(x, 40.0, 1)),
    "position behind a second-order filter": (lambda f: f, lambda x: low_pass(x, 20.0, 2)),
    "position sensor that resonates": (lambda f: f, resonant_sensor),
}


@pytest.mark.parametrize("name", DISTORTED)
def test_no_other_cause_of_a_coherent_residual_looks_like_one(name: str) -> None:
    of_force, of_position = DISTORTED[name]
    force = multisine(25.0, 50.0)
    position = linear_motion(force, RATE)
    part = recording(of_force(acting(force, position, RATE)), of_position(position), noise=(0.05, 1e-7))
    axis = machine().axis("x")
    for settings in (force_filter([part], axis), ForceFilter(position_hz=125.0, force_hz=50.0, delay=0.5)):
        assert drive_resonance([part], axis, settings) is None


@pytest.mark.slow
def test_a_lag_of_the_force_is_not_named_after_a_spring() -> None:
    names = {effect.name for effect in found(0.0, lambda force: low_pass(force, 30.0, 1)).effects}
    assert "flexible_drive" not in names
