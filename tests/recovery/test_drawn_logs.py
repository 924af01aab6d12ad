"""Short logs of one kind of motion each, with one to three effects hidden in one axis: what is named is there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from cases import KNOWN
from plant_data import CAPTURE, ROLES, arm_inputs, measured, nominal

from sysid.datasets.recording import Dataset, Recording
from sysid.gap import find_gap
from sysid.machine import KnownEffect

Array = npt.NDArray[np.float64]
#: Length of a log [s], and ramps of its commands [s].
SECONDS, EDGE = 10.0, 0.2


def stroke(time: Array, begin: float, hold: float, level: float) -> Array:
    """A command that ramps to ``level``, holds it, and ramps back."""
    return np.asarray(level * np.clip(np.minimum(time - begin, begin + hold + 2.0 * EDGE - time) / EDGE, 0.0, 1.0))


def to_one_side(time: Array, rng: np.random.Generator) -> Array:
    command, begin = np.zeros(len(time)), 0.5
    while begin < SECONDS - 1.0:
        hold = rng.uniform(0.4, 0.9)
        command += stroke(time, begin, hold, rng.uniform(0.35, 0.55))
        begin += hold + 2.0 * EDGE + rng.uniform(0.2, 0.6)
    return command


def one_level(time: Array, rng: np.random.Generator) -> Array:
    command, begin, level = np.zeros(len(time)), 0.5, rng.uniform(0.4, 0.7)
    while begin < SECONDS - 1.0:
        hold = rng.uniform(0.5, 1.0)
        command += stroke(time, begin, hold, level)
        level, begin = -level, begin + hold + 2.0 * EDGE + rng.uniform(0.1, 0.5)
    return command


def sine(time: Array, rng: np.random.Generator) -> Array:
    level, hertz, phase = rng.uniform(0.3, 0.6), rng.uniform(0.08, 0.15), rng.uniform(0.0, 2.0 * np.pi)
    return np.asarray(level * np.sin(2.0 * np.pi * hertz * time + phase) * np.clip(time - 0.5, 0.0, 1.0))


def small(time: Array, rng: np.random.Generator) -> Array:
    return np.asarray(
        rng.uniform(0.12, 0.2) * np.sin(2.0 * np.pi * rng.uniform(0.2, 0.4) * time) * np.clip(time - 0.5, 0.0, 1.0)
    )


def once(time: Array, rng: np.random.Generator) -> Array:
    return stroke(time, 1.0, rng.uniform(0.6, 1.6), rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 0.8))


SHAPES: tuple[Callable[[Array, np.random.Generator], Array], ...] = (to_one_side, one_level, sine, small, once)
#: Effect → ranges of its parameters.
HIDDEN: dict[str, dict[str, tuple[float, float]]] = {
    "valve_deadband": {"positive": (0.05, 0.3), "negative": (0.05, 0.3)},
    "gain_curve": {"exponent": (0.7, 2.0)},
    "asymmetric_gain": {"ratio": (0.55, 1.7)},
    "backlash": {"width": (0.005, 0.03)},
    "input_delay": {"delay": (0.06, 0.2)},
    "first_order_lag": {"time_constant": (0.08, 0.25)},
    "gain_error": {"ratio": (0.65, 1.5)},
    "command_rate_limit": {"rate": (0.8, 2.0)},
    "temperature_drift": {"fraction": (0.15, 0.4), "time_constant": (5.0, 20.0)},
    "internal_leakage": {"rate": (1e-4, 6e-4)},
    "stiction": {"breakaway": (0.15, 0.3), "release": (0.05, 0.12)},
    "flow_saturation": {"limit": (0.2, 0.5)},
    "valve_hysteresis": {"width": (0.04, 0.12)},
}


def log(name: str, seed: int, axis: str, shape: Callable[[Array, np.random.Generator], Array]) -> Recording:
    """Commands of one axis, the others at rest."""
    made = arm_inputs(name, SECONDS, seed)
    still = {f"{other}.command": 0.0 for other in ("slew", "boom", "wrist")}
    command = shape(made.values("time"), np.random.default_rng([seed, 7]))
    return replace(made, table=made.table.assign(**{**still, f"{axis}.command": command}))


@pytest.mark.parametrize("case", [pytest.param(k, marks=() if k < 3 else pytest.mark.slow) for k in range(60)])
def test_what_is_named_is_there(case: int) -> None:
    rng = np.random.default_rng([202, case])
    axis = ("slew", "boom")[case // len(SHAPES) % 2]
    plant = nominal(*KNOWN, streams=CAPTURE)
    truth, hidden = plant, rng.choice(list(HIDDEN), rng.integers(1, 4), replace=False)
    for name in hidden:
        values = {key: float(rng.uniform(*limits)) for key, limits in HIDDEN[name].items()}
        if name == "internal_leakage" and axis == "slew":
            values = {key: 20.0 * value for key, value in values.items()}  # of a joint, in rad/s
        truth = truth.with_effect(KnownEffect(str(name), axis, values, "drive" if name == "backlash" else None))
    logs = [log(f"run-{k + 1}", 100 * case + k, axis, SHAPES[case % len(SHAPES)]) for k in range(len(ROLES))]
    recordings = [measured(truth, each, 100 * case + k) for k, each in enumerate(logs)]
    dataset = Dataset.of(truth.machine, recordings, {r.name: role for r, role in zip(recordings, ROLES, strict=True)})
    assert {(e.name, e.target) for e in find_gap(dataset, plant).effects} <= {(name, axis) for name in hidden}
