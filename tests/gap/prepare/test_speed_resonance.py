"""The resonance of a speed-commanded drive from command and motion, and none where its speed only lags."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from sysid.datasets import Recording
from sysid.gap.prepare.drives import SpeedResonance, speed_resonance
from sysid.gap.problem import drive_problem
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import compile_plant, free_run, nominal_plant

RATE = 500.0
MACHINE = machine_from_files(
    {
        "machine.toml": (
            f'schema = 1\nname = "turn"\nrate_hz = {RATE}\n[[axes]]\nname = "x"\nactuation = "velocity"\ndrives = "joint"\n'
            "limits = [-50.0, 50.0]\ngain = 1.0\n"
        )
    },
    "turn",
)


def found(*truth: KnownEffect) -> SpeedResonance | None:
    """The resonance of the nominal plant's response to a multisine up to 60 Hz, recorded of ``truth``."""
    rng = np.random.default_rng(0)
    time = np.arange(round(20.0 * RATE)) / RATE
    command = np.sin(2 * np.pi * np.outer(time, np.geomspace(0.5, 60.0, 60)) + rng.uniform(0, 6.28, 60)).mean(axis=1)
    table = pd.DataFrame({"time": time, "x.command": 3.0 * command * (1.0 - np.exp(-time / 0.1)), "x.joint": 0.0})
    nominal = nominal_plant(MACHINE)
    plant = nominal
    for effect in truth:
        plant = plant.with_effect(effect)
    still = Recording("run", table.assign(**{"x.joint": np.where(time < 0.01, 0.0, np.nan)}), RATE)
    moved = free_run(plant, still)["x.joint"].to_numpy() + 2e-5 * rng.standard_normal(len(time))
    model = compile_plant(nominal)
    problem = drive_problem(model, MACHINE.axis("x"))
    return speed_resonance(problem, [Recording("run", table.assign(**{"x.joint": moved}), RATE)], model.theta)


@pytest.mark.parametrize("frequency", [15.0, 28.0, 50.0])
def test_frequency_and_damping_beside_a_lag(frequency: float) -> None:
    spring = KnownEffect("oil_compressibility", "x", {"frequency": frequency, "damping_ratio": 0.04})
    resonance = found(spring, KnownEffect("first_order_lag", "x", {"time_constant": 0.006}))
    assert resonance is not None
    assert resonance.frequency == pytest.approx(frequency, rel=0.01)
    assert resonance.damping_ratio == pytest.approx(0.04, rel=0.25)


@pytest.mark.parametrize(
    "effect",
    [
        KnownEffect("first_order_lag", "x", {"time_constant": 0.02}),
        KnownEffect("input_delay", "x", {"delay": 0.013}),
        KnownEffect("valve_deadband", "x", {"positive": 0.1, "negative": 0.1}),
        KnownEffect("command_rate_limit", "x", {"rate": 8.0}),
        KnownEffect("gain_error", "x", {"ratio": 1.3}),
    ],
    ids=lambda effect: effect.name,
)
def test_no_other_effect_looks_like_one(effect: KnownEffect) -> None:
    assert found(effect) is None


def test_low_ones_are_left_to_the_start_values_of_the_effect() -> None:
    assert found(KnownEffect("oil_compressibility", "x", {"frequency": 6.0, "damping_ratio": 0.1})) is None
