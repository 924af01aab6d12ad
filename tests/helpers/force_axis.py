"""Force axes with motion that follows exactly from a force held over each step: rigid, or two masses with a spring."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.linalg import expm

from sysid.datasets import Recording
from sysid.machine import Machine, machine_from_files

Array = npt.NDArray[np.float64]

MASS = 2.0


def machine(rate_hz: float = 1000.0) -> Machine:
    text = (
        f'schema = 1\nname = "stage"\nrate_hz = {rate_hz}\n[[axes]]\nname = "x"\njoint = "x_joint"\nactuation = "force"\n'
        f'drives = "joint"\nlimits = [-5.0, 5.0]\ninertia = {MASS}\ngain = 1.0\n'
    )
    return machine_from_files({"machine.toml": text}, "stage")


def multisine(seconds: float, last_hz: float, rate_hz: float = 1000.0, seed: int = 0, first_hz: float = 0.5) -> Array:
    """Force [N] of equal amplitudes between two frequencies, (n,)."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    frequency = np.linspace(first_hz, last_hz, 60)
    return np.asarray(np.sin(2 * np.pi * np.outer(time, frequency) + rng.uniform(0, 6.28, 60)).sum(axis=1))


def linear_motion(force: Array, rate_hz: float, stiffness: float = 0.0, load: float = 0.0, damping: float = 0.2) -> Array:
    """Position of the mass, to which a ``load`` hangs by a spring, under a force held over each step; held near zero, (n,)."""
    hold, brake = MASS * 4.0, MASS * 2.0
    motor = max(MASS - load, 1e-9)
    a = np.zeros((4, 4))
    a[0, 2] = a[1, 3] = 1.0
    a[2] = [-(hold + stiffness) / motor, stiffness / motor, -(brake + damping) / motor, damping / motor]
    if load:
        a[3] = [stiffness / load, -stiffness / load, damping / load, -damping / load]
    b = np.array([0.0, 0.0, 1.0 / motor, 0.0])
    whole = expm(np.block([[a, b[:, None]], [np.zeros((1, 5))]]) / rate_hz)
    state, out = np.zeros(4), np.empty(len(force))
    for k in range(len(force)):
        out[k] = state[0]
        state = whole[:4, :4] @ state + whole[:4, 4] * force[k]
    return out


def recording(
    force: Array, position: Array, rate_hz: float = 1000.0, noise: tuple[float, float] = (0.0, 0.0), seed: int = 1
) -> Recording:
    """One recording with white noise of the force and of the position."""
    rng = np.random.default_rng(seed)
    table = pd.DataFrame(
        {
            "time": np.arange(len(force)) / rate_hz,
            "x.command": force + noise[0] * rng.standard_normal(len(force)),
            "x.joint": position + noise[1] * rng.standard_normal(len(force)),
        }
    )
    return Recording("run", table, rate_hz)


def acting(force: Array, position: Array, rate_hz: float) -> Array:
    """The force on the mass besides the spring and damper that hold it in place, (n,): what a motor's log contains.

    Speed and place of the middle of the step, in which the force is held.
    """
    after = np.append(position[1:], 2.0 * position[-1] - position[-2])
    return np.asarray(force - MASS * 4.0 * 0.5 * (position + after) - MASS * 2.0 * (after - position) * rate_hz)
