"""Classical policies on inverse kinematics: coordinated motion to a new target, shaped setpoints, damping of the swing."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.plant import Plant
from sysid_rl.control import CylinderController
from sysid_rl.control.coordinated_motion import CoordinatedMotion, MotionLimits, coordinated_motion
from sysid_rl.control.input_shaper import InputShaper, ShapedSetpoints
from sysid_rl.control.swing_damper import SwingDamper
from sysid_rl.train.environment import Policy
from sysid_rl.train.inverse_kinematics import InverseKinematics, KinematicChain
from sysid_rl.train.least_time_goal import least_time_goal
from sysid_rl.train.residual_observation import ResidualObservation
from sysid_rl.train.task import ObservationSlices
from sysid_rl.train.tracking import StatefulPolicy

Array = npt.NDArray[np.float64]


class CoordinatedPolicy:
    """Move to each new target from rest to rest, all axes in proportion (:mod:`sysid_rl.control.coordinated_motion`).

    For one copy of a machine, and targets that rest between their changes. A setpoint is that of the motion one sample later;
    a controller with ``preview`` follows it late by that time, and without a lag of its own.

    Args:
        plant: its linkages map joints to driven coordinates.
        inverse: target → joints.
        limits: of the motion.
        least_time: of all joints for the target, move to those that are reached first; else to the nearest by inverse
            kinematics.
    """

    def __init__(self, plant: Plant, inverse: InverseKinematics, limits: MotionLimits, least_time: bool = False) -> None:
        self.inverse, self.limits, self.least_time = inverse, limits, least_time
        self._controller = CylinderController(plant)
        self._linkages = [plant.linkages[axis.name] if axis.drives == "cylinder" else None for axis in plant.machine.axes]
        self._slices, self._dt = ObservationSlices.of(len(inverse.low)), 1.0 / plant.machine.rate_hz
        self._last = self._target = np.full(0, np.nan)
        self._motion: CoordinatedMotion | None = None
        self._steps = 0

    def reset(self, observations: Array) -> None:
        """Rest at the measured joints."""
        self._last = np.array(observations[0, self._slices.joints], dtype=np.float64)
        self._target, self._motion = np.full(3, np.nan), None

    def act(self, observations: Array) -> Array:
        if not len(self._last):
            self.reset(observations)
        target = observations[0, self._slices.target]
        if self._motion is None or not np.array_equal(target, self._target):
            self._target, self._steps = target.copy(), 0
            begin, end = self._controller.drive(np.array([self._last, self._goal(target)]))
            self._motion = coordinated_motion(begin, end, self.limits)
        self._steps += 1
        self._last = self._joints(self._motion.at(self._steps * self._dt))
        return self._last[None].copy()

    def _goal(self, target: Array) -> Array:
        if self.least_time:
            return least_time_goal(self.inverse, self._controller, self.limits, self._last, target)
        joints, _ = self.inverse.solve(target[None], self._last[None])
        return np.asarray(joints[0])

    def _joints(self, drive: Array) -> Array:
        return np.array(
            [
                d if linkage is None else float(linkage.joint(np.array([d]))[0])
                for d, linkage in zip(drive, self._linkages, strict=True)
            ]
        )


class ShapedPolicy:
    """The setpoints of another policy through an input shaper.

    Args:
        policy: joint setpoints of one machine.
        rate_hz: setpoints per second.
    """

    def __init__(self, policy: Policy, shaper: InputShaper, rate_hz: float, axes: int) -> None:
        self.policy, self._slices = policy, ObservationSlices.of(axes)
        self._shaped = ShapedSetpoints(shaper, rate_hz, axes)

    def reset(self, observations: Array) -> None:
        """Rest at the measured joints."""
        if isinstance(self.policy, StatefulPolicy):
            self.policy.reset(observations)
        self._shaped.reset(observations[:, self._slices.joints])

    def act(self, observations: Array) -> Array:
        return self._shaped.step(self.policy.act(observations))


class DampedPolicy:
    """The setpoints of another policy, offset by the damping of a measured swing.

    Args:
        policy: joint setpoints of one machine.
        inverse: on the kinematics ``chain``; an offset of the tip is solved from the setpoints of ``policy``.
        damper: from the swing to the offset of the tip.
    """

    def __init__(self, policy: Policy, inverse: InverseKinematics, chain: KinematicChain, damper: SwingDamper) -> None:
        self.policy, self.inverse, self.chain, self.damper = policy, inverse, chain, damper

    def reset(self, observations: Array) -> None:
        """Rest at the measured joints."""
        if isinstance(self.policy, StatefulPolicy):
            self.policy.reset(observations)

    def act(self, observations: Array) -> Array:
        planned = self.policy.act(observations)
        tips = self.chain.predict(planned) + self.damper.offset(*ResidualObservation.swing(observations))
        joints, _ = self.inverse.solve(tips, planned)
        return joints
