"""Swing of a hanging tool that is not measured: the identified pendulum, driven by the motion of the tip.

The equation is that of ``gripper_sway``. An error of its start decays with the damping of the swing. Wind, contact and a
pendulum of another length are not seen.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.effects import gripper_sway
from sysid.effects.compiled import kernel
from sysid_rl.control.pendulum import Pendulum

Array = npt.NDArray[np.float64]


class SwingEstimator:
    """The tools of ``copies`` machines.

    Args:
        pendulum: identified.
        rate_hz: samples per second.
    """

    def __init__(self, pendulum: Pendulum, rate_hz: float, copies: int = 1) -> None:
        self.pendulum, self.rate_hz = pendulum, rate_hz
        self._parameters = np.array([pendulum.length, pendulum.damping_ratio])
        self._state = np.full((copies, gripper_sway.MEMORY), np.nan)
        self._below = np.tile([0.0, 0.0, -pendulum.length], (copies, 1))

    def reset(self, tips: npt.ArrayLike) -> None:
        """The tools hang at rest below tips (n, 3) [m]."""
        self._state[:] = np.nan
        self.step(tips)

    def step(self, tips: npt.ArrayLike) -> tuple[Array, Array]:
        """Position [m] and speed [m/s] of the tools relative to the tips, (n, 3) each.

        Args:
            tips: at the next sample, (n, 3) [m].
        """
        at, before = np.ascontiguousarray(tips, dtype=np.float64), self._below
        tools = np.empty_like(at)
        _advance(self._parameters, self._state, at, 1.0 / self.rate_hz, tools)
        self._below = tools - at
        return self._below.copy(), (self._below - before) * self.rate_hz


@kernel
def _advance(p, state, tips, dt, tools):
    """One sample of all tools (n, 3), with the memory (n, MEMORY) of the effect."""
    for n in range(len(tips)):
        gripper_sway.step(tips[n, 0], tips[n, 1], tips[n, 2], p, 0, state[n], 0, dt, tools[n])
