"""An effect that the recordings do not excite gets no name, and no other effect gets its name in its place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import KNOWN
from plant_data import CAPTURE, ROLES, arm_inputs, measured, nominal

from sysid.datasets.recording import Dataset, Recording
from sysid.gap import find_gap
from sysid.machine import KnownEffect
from sysid.plant import Plant

#: Hidden on one axis: effects that strokes of one speed to one side do not excite, beside some that they do.
HIDDEN = {
    "dead-band": (KnownEffect("valve_deadband", "", {"positive": 0.2, "negative": 0.25}),),
    "curve": (KnownEffect("gain_curve", "", {"exponent": 1.8}),),
    "one side": (KnownEffect("asymmetric_gain", "", {"ratio": 1.5}), KnownEffect("backlash", "", {"width": 0.02}, "drive")),
    "play": (
        KnownEffect("valve_deadband", "", {"positive": 0.2, "negative": 0.25}),
        KnownEffect("backlash", "", {"width": 0.02}, "drive"),
    ),
    "warmth": (KnownEffect("temperature_drift", "", {"fraction": 0.4, "time_constant": 8.0}),),
}
DELAY = KnownEffect("input_delay", "", {"delay": 0.12})


def strokes(name: str, seconds: float, seed: int, axis: str) -> Recording:
    """One axis moves to one side, by commands of about half, with pauses."""
    rng = np.random.default_rng(seed)
    made = arm_inputs(name, seconds, seed)
    time, edge, at = made.values("time"), 0.25, 0.5
    command = np.zeros(len(time))
    while at < seconds - 1.0:
        hold, level = rng.uniform(0.4, 0.9), rng.uniform(0.35, 0.55)
        shape = np.minimum(time - at, at + hold + 2.0 * edge - time) / edge
        command = np.maximum(command, level * np.clip(shape, 0.0, 1.0))
        at += hold + 2.0 * edge + rng.uniform(0.2, 0.6)
    still = {f"{other}.command": 0.0 for other in ("slew", "boom", "wrist")}
    return replace(made, table=made.table.assign(**{**still, f"{axis}.command": command}))


def of_strokes(truth: Plant, axis: str, seed: int) -> Dataset:
    """Four recordings of nine seconds."""
    recordings = []
    for k in range(len(ROLES)):
        number = 10 * seed + k
        recordings.append(measured(truth, strokes(f"run-{k + 1}", 9.0, number, axis), number))
    return Dataset.of(truth.machine, recordings, {r.name: role for r, role in zip(recordings, ROLES, strict=True)})


#: The rest belongs to the slow tier.
FAST = (("play", "slew", 2), ("curve", "boom", 2))
EVERY = [(what, axis, seed) for what in HIDDEN for axis in ("slew", "boom") for seed in (1, 2)]


@pytest.mark.parametrize(
    ("what", "axis", "seed"), [pytest.param(*case, marks=() if case in FAST else pytest.mark.slow) for case in EVERY]
)
def test_nothing_is_named_in_place_of_an_effect_that_is_not_excited(what: str, axis: str, seed: int) -> None:
    plant = nominal(*KNOWN, streams=CAPTURE)
    hidden = [replace(effect, target=axis) for effect in (*HIDDEN[what], DELAY)]
    truth = plant
    for effect in hidden:
        truth = truth.with_effect(effect)
    result = find_gap(of_strokes(truth, axis, seed), plant)
    assert {(e.name, e.target) for e in result.effects} <= {(e.name, e.target) for e in hidden}
    assert result.verdict in ("named", "unnamed", "ambiguous", "insufficient_excitation")
