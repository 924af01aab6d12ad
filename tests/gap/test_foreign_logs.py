"""Answers where the machine is not the plant with other numbers: what logs from elsewhere have taught, rebuilt.

The machines here are written down in the test, so that their formulas are not those of the catalogue.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from plant_data import ROLES, arm_inputs, dataset_of, measured, nominal, slide, slide_inputs

from sysid.datasets.recording import Dataset, Recording
from sysid.gap import GapResult, find_gap
from sysid.machine import KnownEffect
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
NOISE = 5e-6


def changed(recording: Recording, **columns: Array) -> Recording:
    return replace(recording, table=recording.table.assign(**{k.replace("__", "."): v for k, v in columns.items()}))


def dataset(plant: Plant, recordings: list[Recording]) -> Dataset:
    return Dataset.of(plant.machine, recordings, {r.name: role for r, role in zip(recordings, ROLES, strict=True)})


def names(found: GapResult) -> list[tuple[str, str]]:
    return [(effect.name, effect.target) for effect in found.effects]


def rubbed(friction: Callable[[float, float], float], seconds: float, seed: int, mass: float = 20.0) -> list[Recording]:
    """A slide of 20 kg that is held back by ``friction`` (force of speed and travel), in steps of 0.1 ms."""
    recordings = []
    for k in range(len(ROLES)):
        inputs = slide_inputs(f"run-{k + 1}", seconds, 10 * seed + k)
        force, place, speed = inputs.values("slide.command"), 0.0, 0.0
        out = np.empty(len(force))
        for i, push in enumerate(force):
            out[i] = place
            for _ in range(20):
                speed += 1e-4 * (push - friction(speed, place)) / mass
                place += 1e-4 * speed
        noise = NOISE * np.random.default_rng([seed, k]).standard_normal(len(out))
        table = inputs.table[["time"]].assign(**{"slide.command": inputs.values("at_samples"), "slide.joint": out + noise})
        recordings.append(replace(inputs, table=table))
    return recordings


# -- what is named is there -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("force", [pytest.param(force, marks=pytest.mark.slow) for force in (0.003, 0.01, 0.1)] + [0.03])
def test_no_interval_of_a_name_contains_its_absence(force: float) -> None:
    """Friction from far below what shows up to what does."""
    true = nominal(KnownEffect("coulomb_friction", "slide", {"force": force}), machine=slide())
    found = find_gap(dataset_of(true, 4.0, seed=7, noise=4.0), nominal(machine=slide()))
    for effect in found.effects:
        assert effect.name == "coulomb_friction"
        low, high = effect.interval95["force"]  # type: ignore[misc]
        assert low > 0.0
        assert low <= force <= high


def test_what_the_held_out_recording_does_not_have_gets_no_name() -> None:
    """A dead-band in the recordings to fit that is gone in the last one, where the repair would make the error larger."""
    worn = nominal(KnownEffect("valve_deadband", "slew", {"positive": 0.08, "negative": 0.08}))
    recordings = []
    for k, role in enumerate(ROLES):
        inputs = arm_inputs(f"run-{k + 1}", 12.0, 90 + k)
        recordings.append(measured(nominal() if role == "held_out" else worn, inputs, 90 + k))
    found = find_gap(dataset(nominal(), recordings), nominal())
    assert found.effects == ()
    assert any("held-out" in note for note in found.notes)


@pytest.mark.slow
def test_friction_that_saturates_smoothly_is_not_viscous() -> None:
    """It grows with the speed and then no more; a viscous friction alone would be a substitute."""
    recordings = rubbed(lambda v, x: 22.0 * float(np.tanh(v / 0.15)), 8.0, seed=1)
    plant = nominal(machine=slide())
    found = find_gap(dataset(plant, recordings), plant)
    assert ("viscous_friction", "slide") not in names(found)


@pytest.mark.slow
def test_inertia_gets_no_name_where_friction_has_a_memory() -> None:
    """Dahl's friction: the force follows the travel after each reversal, as a spring does at first."""
    state = {"z": 0.0, "x": 0.0}

    def dahl(v: float, x: float) -> float:
        state["z"] += 1e-4 * v * (1.0 - np.sign(v) * state["z"] / 15.0) * 8000.0
        return state["z"]

    recordings = rubbed(dahl, 8.0, seed=2)
    plant = nominal(machine=slide())
    found = find_gap(dataset(plant, recordings), plant)
    assert ("inertia_error", "slide") not in names(found)
    assert {name for name, _ in names(found)} <= {"coulomb_friction", "stribeck_friction"}


# -- effects that are not distinguishable -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_two_splits_of_smooth_motion_do_not_give_two_names() -> None:
    """A servo that is late, asked for slow sines alone: a lag and a dead time do the same."""
    true = nominal(KnownEffect("first_order_lag", "wrist", {"time_constant": 0.08}))
    recordings = []
    for k in range(len(ROLES)):
        inputs = arm_inputs(f"run-{k + 1}", 25.0, 70 + k)
        time = inputs.values("time")
        slow = sum(0.3 * np.sin(2.0 * np.pi * (0.05 + 0.02 * j + 0.005 * k) * time + j) for j in range(3))
        still = {"slew__command": 0.0 * time, "boom__command": 0.0 * time}
        recordings.append(measured(true, changed(inputs, wrist__command=slow, **still), 70 + k, noise=5.0))
    answers = []
    for order in (recordings, recordings[::-1]):
        again = [replace(r, name=f"run-{k + 1}") for k, r in enumerate(order)]
        answers.append(find_gap(dataset(nominal(), again), nominal()))
    assert {name for found in answers for name in names(found)} <= {("first_order_lag", "wrist")}


@pytest.mark.slow
def test_intervals_of_one_joint_from_two_sets_overlap() -> None:
    """The friction is none of the catalogue: what formulas cannot do is in the intervals."""

    def friction(v: float, x: float) -> float:
        return (16.0 + 3.0 * float(np.sin(9.0 * x))) * float(np.tanh(v / 0.01)) + 30.0 * v

    plant = nominal(machine=slide())
    known = {}
    for seed in (5, 6):
        found = find_gap(dataset(plant, rubbed(friction, 8.0, seed)), plant)
        for effect in found.effects:
            for key, interval in effect.interval95.items():
                known.setdefault((effect.name, key), []).append(interval)
    assert ("coulomb_friction", "force") in known
    for key, intervals in known.items():
        if len(intervals) == 2:
            (low, high), (other_low, other_high) = intervals
            assert low <= other_high, key
            assert other_low <= high, key


# -- two days ----------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_two_days_with_different_gains_show_the_same_effect() -> None:
    """Oil is warmer on the second day: all is 4 % faster. The dead-band is there on both."""
    band = KnownEffect("valve_deadband", "slew", {"positive": 0.1, "negative": 0.1})
    recordings = []
    for k, ratio in enumerate((1.0, 1.04, 1.0, 1.04)):
        true = nominal(band, KnownEffect("gain_error", "slew", {"ratio": ratio}))
        recordings.append(measured(true, arm_inputs(f"run-{k + 1}", 25.0, 110 + k), 110 + k))
    found = find_gap(dataset(nominal(), recordings), nominal())
    assert ("valve_deadband", "slew") in names(found)
    assert set(names(found)) <= {("valve_deadband", "slew"), ("gain_error", "slew")}
