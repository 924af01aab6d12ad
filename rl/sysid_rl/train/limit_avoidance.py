"""Redundancy used to keep joints away from their limits: gradient projection.

A redundant machine can move its joints without moving the end effector, along the null space of the Jacobian J. In shares u of
each joint's range, inverse kinematics is started from

    u + min(rate·dt, gain·|n·g|)·sign(n·g)·n        J·n = 0, ‖n‖ = 1, g = ∂H/∂u, H = Σ ln u + ln(1 − u)

where H is the logarithmic barrier of the limits; the solver then puts the end effector back on its target.

Source: Liégeois, IEEE Transactions on Systems, Man, and Cybernetics 7 (1977) 868–871.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid_rl.train.inverse_kinematics import InverseKinematics, KinematicChain
from sysid_rl.train.task import ObservationSlices

Array = npt.NDArray[np.float64]

#: Greatest motion along the null space [shares of the range per second], and step for a gradient of one.
RATE, GAIN = 0.1, 1e-4
#: Joints nearer to a limit than this share count as that near: the barrier is infinite there.
NEAREST = 1e-3
#: Finite difference of the Jacobian [shares of the range].
DIFFERENCE = 1e-6


class LimitAvoidingPolicy:
    """Inverse kinematics of one machine that moves along the null space, away from the limits.

    Args:
        inverse: bounded inverse kinematics on ``chain``.
        rate_hz: setpoints per second.

    Raises:
        SettingsError: a machine that is not redundant.
    """

    def __init__(self, inverse: InverseKinematics, chain: KinematicChain, rate_hz: float) -> None:
        if len(inverse.low) < 4:
            found = f"{len(inverse.low)} joints for the three coordinates of a point"
            raise SettingsError("limit avoidance", found, "a redundant machine: four joints or more")
        self.inverse, self.chain = inverse, chain
        self._most, self._slices = RATE / rate_hz, ObservationSlices.of(len(inverse.low))
        self._last: Array | None = None

    def reset(self, observations: Array) -> None:
        """Search from the measured joints."""
        self._last = np.array(observations[0, self._slices.joints], dtype=np.float64)

    def act(self, observations: Array) -> Array:
        if self._last is None:
            self.reset(observations)
        assert self._last is not None
        begin = np.clip(self.away(self._last), self.inverse.low, self.inverse.high)
        joints, _ = self.inverse.solve(observations[:, self._slices.target], begin[None])
        self._last = joints[0]
        return joints

    def away(self, joints: Array) -> Array:
        """Joints (A,) after one step along the null space."""
        low, span = self.inverse.low, self.inverse.high - self.inverse.low
        share = np.clip((joints - low) / span, NEAREST, 1.0 - NEAREST)
        slope = 1.0 / share - 1.0 / (1.0 - share)
        for direction in self._null_space(joints, span):
            pull = float(direction @ slope)
            joints = joints + span * direction * min(max(GAIN * pull, -self._most), self._most)
        return joints

    def _null_space(self, joints: Array, span: Array) -> Array:
        """Orthonormal directions, (A − 3, A), in shares of the range."""
        steps = DIFFERENCE * np.diag(span)
        ends = self.chain.predict(np.concatenate([joints + steps, joints - steps]))
        acts = len(joints)
        jacobian = (ends[:acts] - ends[acts:]).T / (2.0 * DIFFERENCE)
        return np.asarray(np.linalg.svd(jacobian)[2][3:])
