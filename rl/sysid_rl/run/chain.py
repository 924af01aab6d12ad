"""Sensors to valves: joints → end effector → policy or inverse kinematics → joint setpoints → cylinder controller → commands.

The parts are those of training and evaluation (:mod:`sysid_rl.train.driven`): the same forward version, observation and
:class:`sysid_rl.control.CylinderController`; here the supervisor is between them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sysid.effects import gripper_sway
from sysid.errors import SettingsError
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid_rl.control import CylinderController
from sysid_rl.control.input_shaper import InputShaper, ShapedSetpoints
from sysid_rl.control.pendulum import pendulum_of
from sysid_rl.control.swing_estimator import SwingEstimator
from sysid_rl.run.limits import Limits
from sysid_rl.run.policy_thread import PolicyThread
from sysid_rl.train.environment import NamedPolicy
from sysid_rl.train.inverse_kinematics import InverseKinematics
from sysid_rl.train.observation import DrivenObservation
from sysid_rl.train.residual_policy import ResidualPolicy
from sysid_rl.train.task import ObservationSlices

Array = npt.NDArray[np.float64]

#: Steps in which a policy comes to rest, and the change of a step that counts as rest, as a share of a joint's range.
REST_STEPS, REST = 20, 1e-3


class SignalPolicy(NamedPolicy, Protocol):
    """A policy with the names of its observations and setpoints."""

    @property
    def outputs(self) -> tuple[str, ...]: ...


class ControlChain:
    """The controllers of one machine.

    Args:
        plant: linkages and effects for the cylinder controller.
        forward: joints → end effector.
        inverse: inverse kinematics, the fallback of a policy.
        policy: None: inverse kinematics.
        lookahead: of the targets, after the next sample [s].
        shaper: of the setpoints for targets.

    Raises:
        SettingsError: observations or setpoints of the policy do not fit this machine.
    """

    def __init__(
        self,
        plant: Plant,
        forward: ForwardModel,
        inverse: InverseKinematics,
        *,
        policy: SignalPolicy | None = None,
        lookahead: float = 0.0,
        shaper: InputShaper | None = None,
    ) -> None:
        self.plant, self.forward, self.inverse, self.policy, self.lookahead = plant, forward, inverse, policy, lookahead
        self.axes = plant.machine.axis_names
        self.controller = CylinderController(plant, preview=lookahead)
        # Number of past commands of each axis in the observations.
        history = sum(".command[" in name for name in policy.inputs) // len(self.axes) if policy is not None else 0
        self.view = DrivenObservation(self.axes, history, plant.machine.rate_hz)
        self._width = self.view.width
        #: Runs the policy; None without one.
        self.thread: PolicyThread | None = None
        if policy is not None:
            self._check(policy)
            self._width = len(policy.inputs)
            self.thread = PolicyThread(policy, len(self.axes))
        self._shaped = None if shaper is None else ShapedSetpoints(shaper, plant.machine.rate_hz, len(self.axes))
        #: Time for which a setpoint depends on past ones [s].
        self.shaped_s = 0.0 if shaper is None else shaper.times[-1]
        self._joints: Array | None = None
        self._solved: Array | None = None
        self._swing: SwingEstimator | None = None
        self._below = np.zeros((1, 3))
        if plant.effect(gripper_sway.EFFECT.name, "tool") is not None:
            pendulum = pendulum_of(plant)
            self._below = np.array([[0.0, 0.0, -pendulum.length]])
            if policy is not None and any(name.startswith("tool.") for name in policy.inputs):
                self._swing = SwingEstimator(pendulum, plant.machine.rate_hz)

    @property
    def ahead(self) -> int:
        """``lookahead`` in steps."""
        return round(self.lookahead * self.plant.machine.rate_hz)

    def tip(self, joints: Array) -> Array:
        """End effectors (n, 3) [m] at joints (n, A)."""
        return np.asarray(self.forward.predict(joints))

    def rest(self, drive: Array, joints: Array) -> None:
        """Reset to rest at ``drive`` (A,), what the commands drive, and joints (A,)."""
        self.controller.reset(drive)
        self.view.rest()
        self._joints, self._solved = joints[None].copy(), None
        if self._shaped is not None:
            self._shaped.reset(joints)
        if isinstance(self.policy, ResidualPolicy):
            self.policy.rest()
        if self._swing is not None:
            self._swing.reset(self.tip(joints[None]))
            self._below = np.array([[0.0, 0.0, -self._swing.pendulum.length]])

    def moved(self, joints: Array, commands: Array) -> None:
        """Record a step with ``commands`` (A,), zero if neutral, that led to ``joints`` (A,).

        A policy that observes the tool gets the swing of the identified pendulum below the tip: no sensor measures it.
        """
        now = joints[None]
        before = now if self._joints is None else self._joints
        self.view.sent(commands[None])
        below = self._below
        if self._swing is not None:
            self._below, _ = self._swing.step(self.tip(now))
        self.view.moved(now, before, self._below, below)
        self._joints = now.copy()

    def ask(self, joints: Array, ee: Array, target: Array, until_ns: int, now_ns: Callable[[], int]) -> Array:
        """Setpoints (A,) of the policy, or of inverse kinematics without one, for a target (3,), through the shaper.

        Args:
            until_ns: deadline of the policy on the clock ``now_ns``.

        Raises:
            PolicyError: no answer by then, or no setpoints.
        """
        if self.thread is None:
            found = self.solve(joints, target)
        else:
            seen = self.view.seen(joints[None], ee[None], target[None], self._below)
            found = self.thread.ask(seen[:, : self._width], until_ns, now_ns)
        return found if self._shaped is None else self._shaped.step(found[None])[0]

    def start(self, target: Array, joints: Array, limits: Limits, near: float) -> Array:
        """Joints (A,) at which the machine rests at a target (3,): where the policy puts it from ``joints``.

        Those are ``joints`` for inverse kinematics, with offsets too, and where the policy does not come to rest within
        ``near`` [m] of the target.
        """
        if self.policy is None or isinstance(self.policy, ResidualPolicy):
            return joints
        low, high, now = limits.low, limits.high, joints
        for _ in range(REST_STEPS):
            before = now
            seen = self.view.seen(now[None], self.tip(now[None]), target[None], self._below)
            now = np.clip(self.policy.act(seen[:, : self._width])[0], low, high)
        rests = (np.abs(now - before) < REST * (high - low)).all()
        return now if rests and float(np.linalg.norm(self.tip(now[None])[0] - target)) < near else joints

    def cancel_policy(self) -> None:
        """Cancel the policy if it is running."""
        if self.thread is not None:
            self.thread.cancel()

    def solve(self, joints: Array, target: Array) -> Array:
        """Setpoints (A,) of inverse kinematics, nearest to its last ones, at first to ``joints``."""
        begin = joints[None] if self._solved is None else self._solved
        self._solved, _ = self.inverse.solve(target[None], begin)
        return np.asarray(self._solved[0].copy())

    def solve_from(self, setpoints: Array) -> None:
        """Continue inverse kinematics, and the shaper, from ``setpoints`` (A,)."""
        self._solved = setpoints[None].copy()
        if self._shaped is not None:
            self._shaped.reset(setpoints)

    def commands(self, setpoints: Array, drive: Array) -> tuple[Array, Array]:
        """Drive setpoints and valve commands, (A,) each, for joint setpoints and measured ``drive`` (A,)."""
        return self.controller.drive(setpoints)[0], self.controller.commands(setpoints, drive)[0]

    def override(self, commands: Array) -> None:
        """Record the commands (A,) that were sent."""
        self.controller.override(commands)

    def _check(self, policy: SignalPolicy) -> None:
        where = f"policy for {self.plant.machine.name}"
        joints = self.view.names[: len(self.axes)]
        if policy.outputs != joints:
            raise SettingsError(where, f"sets {', '.join(policy.outputs)}", f"{', '.join(joints)}")
        for own, wanted in zip(self.view.names, policy.inputs, strict=False):
            if own != wanted:
                raise SettingsError(where, f"observes {wanted!r}", f"{own!r} in its place: it was trained for another machine")
        if len(policy.inputs) > self.view.width or len(policy.inputs) < ObservationSlices.of(len(self.axes)).width:
            raise SettingsError(where, f"observes {len(policy.inputs)} numbers", f"{self.view.width}")
