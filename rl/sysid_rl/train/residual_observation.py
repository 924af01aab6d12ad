"""What a residual policy observes and how its action becomes an offset of the setpoints.

    setpoint = ik(target) + share·(high − low)·a·min(1, A/A₀)        a ∈ [−1, 1] from the policy

A is the amplitude of the swing, ``√(d² + (ḋ/ω₀)²)`` with the horizontal distance d of tool and tip. The offset is proportional
to small swings, so that the machine rests exactly where inverse kinematics puts it.

Source: residual reinforcement learning, Johannink et al. 2018 (arXiv 1812.03201), Silver et al. 2018 (arXiv 1812.06298).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.config import Strict
from sysid_rl.control.pendulum import Pendulum
from sysid_rl.train.task import ObservationSlices

Array = npt.NDArray[np.float64]

#: Swings below this amplitude [m] have no phase: a slew with the usual backlash, 0.01 rad at 1 m, leaves a few of it.
RESOLUTION = 2e-3


@dataclass(frozen=True)
class Residual(Strict):
    """The offset.

    Args:
        share: of each joint's range, the greatest offset.
        full_swing: A₀ [m].
    """

    share: float = 0.05
    full_swing: float = 0.05


class ResidualObservation:
    """Joints (A,), raised tool (3,), target (3,), setpoint error of inverse kinematics (A,), speeds of the joints (A,), mean
    commands within the dead time (A,), last action (A,), amplitude of the swing (1,), and its phase in horizontal polar
    coordinates about the base: distance radial and tangential, the same of its speed, (4,).

    The raised tool is the point that has to reach the target: the tool, lifted by the length of its string.

    Args:
        axes: names of the axes.
        pendulum: the hanging tool.
        residual: bounds of the setpoint error.
        ranges: of the joints, (A,).
    """

    def __init__(self, axes: Sequence[str], pendulum: Pendulum, residual: Residual, ranges: Array) -> None:
        self.axes, self.pendulum = tuple(axes), pendulum
        self.residual, self.bound = residual, residual.share * ranges

        self.slices = ObservationSlices.of(len(self.axes))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns after the first A + 6."""
        each = (f"{axis}.{what}" for what in ("setpoint_error", "speed", "command.mean", "offset[-1]") for axis in self.axes)
        return (*each, "swing.amplitude", *(f"swing.{what}.{way}" for what in ("place", "speed") for way in ("r", "t")))

    def amplitude(self, below: Array, speed: Array) -> Array:
        """Amplitudes (n,) [m] of swings with the tool ``below`` the tip (n, 3) [m] and its ``speed`` there (n, 3) [m/s]."""
        place, rate = below[:, :2], speed[:, :2] / self.pendulum.frequency
        return np.asarray(np.sqrt((place**2).sum(axis=1) + (rate**2).sum(axis=1)))

    def offset(self, actions: Array, driven: Array) -> Array:
        """Offsets (n, A) [rad or m] of actions (n, A) with observations of the full path."""
        share = np.minimum(1.0, self.amplitude(*self.swing(driven)) / self.residual.full_swing)
        return np.asarray(self.bound * actions * share[:, None])

    def of(self, driven: Array, target: Array, solved: Array, last: Array) -> Array:
        """Observations (n, O).

        Args:
            driven: observations of :class:`sysid_rl.train.observation.DrivenObservation`, (n, …).
            target: of the raised tool (n, 3).
            solved: joints of inverse kinematics (n, A).
            last: action (n, A).
        """
        acts, parts = len(self.axes), self.slices
        joints, ee = driven[:, parts.joints], driven[:, parts.ee]
        past, speeds = driven[:, parts.width : -acts - 6], driven[:, -acts - 6 : -6]
        commands = past.reshape(len(driven), -1, acts).mean(axis=1)
        below, speed = self.swing(driven)
        raised = ee + below + [0.0, 0.0, self.pendulum.length]
        error = np.clip(solved - joints, -self.bound, self.bound)
        away = ee[:, :2] / np.maximum(np.linalg.norm(ee[:, :2], axis=1, keepdims=True), 1e-6)
        across = np.column_stack([-away[:, 1], away[:, 0]])
        amplitude = self.amplitude(below, speed)[:, None]
        phase = [
            (vector[:, :2] * way).sum(axis=1, keepdims=True) / (amplitude + RESOLUTION)
            for vector in (below, speed / self.pendulum.frequency)
            for way in (away, across)
        ]
        return np.concatenate([joints, raised, target, error, speeds, commands, last, amplitude, *phase], axis=1)

    @staticmethod
    def swing(driven: Array) -> tuple[Array, Array]:
        """Position and speed of the tool relative to the tip, (n, 3) each, in the observations of the full path."""
        return driven[:, -6:-3], driven[:, -3:]
