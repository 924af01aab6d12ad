"""Sag of a servo with a second-order lag: the weight deflects it as a spring with damping and inertia."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from sagging_servo import RATE_HZ, Servos, gravity_moments, machine_files, recording
from scipy.integrate import solve_ivp

from sysid.datasets.recording import Recording
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import Plant, compile_plant, free_run, nominal_plant

Array = npt.NDArray[np.float64]
COMPLIANCE, TIME_CONSTANT = 0.08, 0.07


def plant_of(damping_ratio: float) -> Plant:
    plant = nominal_plant(machine_from_files(machine_files(True), "servos"))
    lag = {"time_constant": TIME_CONSTANT, "damping_ratio": damping_ratio}
    plant = plant.with_effect(KnownEffect("second_order_lag", "shoulder", lag))
    return plant.with_effect(KnownEffect("joint_compliance", "shoulder", {"compliance": COMPLIANCE}, "drive"))


def spring(take: Recording, load: Array, damping_ratio: float) -> Array:
    """T²·q̈ + 2ζT·q̇ + q = u − c·L, setpoint and load held over the step that ends at a sample; at rest before the first."""
    forced = take.values("shoulder.command") - COMPLIANCE * load
    state, out = np.array([forced[0], 0.0]), np.empty(len(forced))
    for k, value in enumerate(forced):

        def rates(t: float, s: Array, value: float = float(value)) -> list[float]:
            return [s[1], (value - s[0] - 2.0 * damping_ratio * TIME_CONSTANT * s[1]) / TIME_CONSTANT**2]

        state = solve_ivp(rates, (0.0, 1.0 / RATE_HZ), state, rtol=1e-8, atol=1e-10).y[:, -1]
        out[k] = state[0]
    return out


@pytest.mark.parametrize("damping_ratio", [0.4, 1.0, 1.6])
def test_sag_follows_its_load_like_a_spring_with_damping_and_inertia(damping_ratio: float) -> None:
    take = recording(Servos(), "take", 3, 12.0)
    plant = plant_of(damping_ratio)
    model = compile_plant(plant)
    load = gravity_moments(np.column_stack([take.values(f"{axis}.joint") for axis in plant.machine.axis_names]))[:, 1]
    run = model.drive(model.theta[None], take, "shoulder")[0]
    late = slice(round(1.0 * RATE_HZ), None)  # the state before the first sample is estimated
    expected = spring(take, load, damping_ratio)
    assert np.abs(run - expected)[late].max() < 2e-3 * np.ptp(expected)
    straight = spring(take, 0.0 * load, damping_ratio)
    assert np.abs(straight - expected)[late].max() > 0.02 * np.ptp(expected)


def test_a_free_run_begins_with_the_sag_of_its_posture() -> None:
    """At rest the joint is the setpoint less compliance times load from the first sample on."""
    take = recording(Servos({"shoulder": COMPLIANCE}), "take", 3, 12.0)
    still = Recording("still", take.table.iloc[:40].reset_index(drop=True), RATE_HZ)
    assert np.ptp(still.values("shoulder.command")) == 0.0
    run = free_run(plant_of(0.7), still)["shoulder.joint"].to_numpy()
    assert np.abs(run - still.values("shoulder.joint")).max() < 0.1 * COMPLIANCE * 0.5
