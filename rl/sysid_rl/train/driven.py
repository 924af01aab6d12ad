"""The full path: joint setpoint → actuator network → cylinder controller → valve → plant → joints → tip → tool.

The observation is that of :class:`sysid_rl.train.observation.DrivenObservation`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from sysid.effects import gripper_sway
from sysid.errors import InputError, SettingsError, nearest
from sysid.machine.kinematics import GRAVITY
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid.plant.stepper import LaneState, Stepper
from sysid_rl.control import AxisTuning, CylinderController
from sysid_rl.train.environment import Environment
from sysid_rl.train.observation import DrivenObservation, dead_steps
from sysid_rl.train.reach import Reach, tips
from sysid_rl.train.task import Flags, Task

if TYPE_CHECKING:
    from sysid_rl.train.bullet import Worlds

Array = npt.NDArray[np.float64]
Feedback = Literal["static", "plant"]
Mover = Literal["compiled", "pybullet"]


class DrivenEnvironment(Environment):
    """Observation: joints (A,), end effector (3,), target (3,), the last commands (H·A,), speeds of the joints (A,), tool
    relative to the tip (3,) and its speed there (3,). Action: joint setpoints (A,) in SI.

    Args:
        plant, forward, size, seed, task, reach: as of :class:`sysid_rl.train.kinematic.KinematicEnvironment`.
        tuning: of the cylinder controller; by default from the plant (:func:`sysid_rl.control.tune`).
        preview: time after its step for which a setpoint is meant [s], for policies with look-ahead.
        history: number of observed past commands; by default the steps of the longest dead time.
        repeat: samples of the machine for which an action is held, one step of the environment; its reward is that of the last.
            For training: under delay and lag a single sample of 10 ms shows little of the effect of an action.
        feedback: evaluation of candidates: ``static``, by the forward model; ``plant``, by simulating the plant from its
            present state while a candidate is held for the longest dead time, or for ``repeat``.
        mover: ``compiled``, the chain of effects; ``pybullet``, the same plant with rigid bodies (:mod:`.bullet`).
        noise: the controller reads its sensors with the noise of the machine's description.
        start_swing: greatest horizontal distance [m] of the tool from its rest at the beginning of an episode; the distance is
            uniform up to it, in a random direction, without speed (``compiled`` only).

    Raises:
        SettingsError: plant and forward model do not fit, a force axis, an unknown feedback, ``size`` or ``repeat`` below one.
    """

    def __init__(
        self,
        plant: Plant,
        forward: ForwardModel,
        *,
        size: int = 1,
        seed: int = 0,
        task: Task | None = None,
        reach: Reach | None = None,
        tuning: tuple[AxisTuning, ...] | None = None,
        preview: float = 0.0,
        history: int | None = None,
        repeat: int = 1,
        feedback: Feedback = "static",
        mover: Mover = "compiled",
        noise: bool = False,
        start_swing: float = 0.0,
    ) -> None:
        for name, value, valid in (("feedback", feedback, get_args(Feedback)), ("mover", mover, get_args(Mover))):
            if value not in valid:
                raise SettingsError("environment", f"{name} = {value!r}", nearest(value, valid))
        if repeat < 1:
            raise SettingsError("environment", f"repeat = {repeat}", "one sample or more")
        if mover == "pybullet" and feedback == "plant":
            raise SettingsError("environment", "feedback = 'plant' with PyBullet", "mover = 'compiled', or feedback = 'static'")
        if start_swing and mover == "pybullet":
            raise SettingsError("environment", "start_swing with PyBullet", "mover = 'compiled'")
        super().__init__(plant, forward, size, seed, task, reach)
        self.start_swing = start_swing
        self.feedback, self.preview, self.repeat = feedback, preview, repeat
        sampled, self.rate_hz = self.rate_hz, self.rate_hz / repeat
        self._stepper: Stepper | Worlds
        if mover == "pybullet":
            from sysid_rl.train.bullet import Worlds

            self._stepper = Worlds(plant, sampled, size)
        else:
            self._stepper = Stepper(plant, sampled, size)
        self._controller = CylinderController(plant, tuning, copies=size, preview=preview)
        signals = [axis.driven for axis in plant.machine.axes]
        self._noise = np.array([plant.machine.noise.get(signal, 0.0) if noise else 0.0 for signal in signals])
        self._candidates: tuple[Stepper, CylinderController] | None = None
        self.horizon = dead_steps(plant, sampled)
        self.history = self.horizon if history is None else history
        self._target = np.full((size, 3), np.nan)
        self._view = DrivenObservation(plant.machine.axis_names, self.history, sampled, size)
        self.observations, self.names = self._view.width, self._view.names
        self.observation_low, self.observation_high = self._bounds(-1.0), self._bounds(1.0)
        self._lane: LaneState | None = None
        self._final = np.full((size, self.observations), np.nan)

    @property
    def tool(self) -> Array:
        """Positions of the tools, (n, 3) [m]."""
        return self._current().tool.copy()

    @property
    def commands(self) -> Array:
        """The last commands, (n, A)."""
        return self._controller.last

    def look(self) -> Array:
        """Present observations (n, O)."""
        return self._observe()

    def put(self, which: Flags, joints: Array, targets: Array) -> None:
        """Begin an episode in the copies of a mask, at rest at joints and with targets, a row for each of them."""
        self._put(which, joints, targets)

    def step(self, actions: npt.ArrayLike) -> tuple[Array, Array, Flags]:
        wanted = self._checked(actions)
        self._require_finite(bool(np.isfinite(wanted).all()))
        lane, setpoints = self._current(), np.clip(wanted, self.reach.low, self.reach.high)
        for _ in range(self.repeat):
            lane = self._sample(setpoints, lane)
        outside = ((wanted < self.reach.low) | (wanted > self.reach.high)).any(axis=1)
        rewards = self.task.reward(lane.ee, self._target, outside)
        self._count += 1
        observations, truncated = self._end_of_step(lane.joints)
        return observations, rewards, truncated

    def predicted(self, observations: Array, actions: Array) -> Array:
        """End effectors (m, 3) to which candidate ``actions`` (m, A) lead.

        With ``feedback = "plant"`` candidates start from the current states of the copies: m is a multiple of the number of
        copies, and the candidates of a copy follow each other.
        """
        wanted = np.clip(actions, self.reach.low, self.reach.high)
        return self.forward.predict(wanted) if self.feedback == "static" else self._simulated(wanted).ee

    def predicted_tool(self, actions: Array) -> Array:
        """Tools (m, 3) to which candidate ``actions`` (m, A) lead, by simulating the plant."""
        return self._simulated(np.clip(actions, self.reach.low, self.reach.high)).tool

    def _simulated(self, wanted: Array) -> LaneState:
        """The plant after setpoints (m, A) were held from the present state, candidates of a copy in succession."""
        each, rest = divmod(len(wanted), self.size)
        if rest or not each:
            raise InputError("environment", f"{len(wanted)} candidates", f"as many for each of {self.size} copies")
        stepper, controller = self._candidate_models(len(wanted))
        stepper.restore({name: np.repeat(values, each, axis=0) for name, values in self._stepper.state().items()})
        controller.restore({name: np.repeat(values, each, axis=0) for name, values in self._controller.state().items()})
        present, names = self._current(), ("drive", "joints", "structure", "ee", "tool")
        lane = LaneState(*(np.repeat(getattr(present, name), each, axis=0) for name in names))
        for _ in range(max(self.horizon, self.repeat)):
            lane = stepper.step(controller.commands(wanted, self._measured(lane)))
        return lane

    def state(self) -> dict[str, Any]:
        view = {"commands": self._view.commands, "speed": self._view.speed}
        own = {"target": self._target, **view, "final": self._final}
        return {
            **{name: values.copy() for name, values in own.items()},
            "count": self._count.copy(),
            **{f"plant.{name}": values for name, values in self._stepper.state().items()},
            **self._controller.state(),
            "generator": self._rng.bit_generator.state,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        plant = {name.removeprefix("plant."): np.asarray(values) for name, values in state.items() if name.startswith("plant.")}
        self._controller.restore(state)
        self._lane = self._stepper.restore(plant)
        self._target[:] = state["target"]
        self._view.commands[:], self._view.speed[:] = state["commands"], state["speed"]
        self._final = np.array(state["final"], dtype=np.float64)
        self._count[:] = state["count"]
        self._rng.bit_generator.state = state["generator"]

    def _sample(self, setpoints: Array, before: LaneState) -> LaneState:
        """One sample of the machine: sensors, controller, valves, plant, observation."""
        measured = self._measured(before)
        if self._noise.any():
            measured += self._noise * self._rng.standard_normal(measured.shape)
        commands = self._controller.commands(setpoints, measured)
        self._lane = lane = self._stepper.step(commands)
        self._view.sent(commands)
        self._view.moved(lane.joints, before.joints, lane.tool - lane.ee, before.tool - before.ee)
        return lane

    def _current(self) -> LaneState:
        if self._lane is None:
            raise SettingsError("environment", "was never reset", "reset() before the first step")
        return self._lane

    def _measured(self, lane: LaneState) -> Array:
        """Measurements of the controller: draw wires of the cylinders, sensors of the other joints."""
        return np.where(self._controller.cylinders, lane.drive, lane.joints)

    def _observe(self) -> Array:
        lane = self._current()
        return self._view.seen(lane.joints, lane.ee, self._target, lane.tool - lane.ee)

    def _candidate_models(self, count: int) -> tuple[Stepper, CylinderController]:
        if self._candidates is None or self._candidates[0].lanes != count:
            controller = CylinderController(self.plant, self._controller.tuning, copies=count, preview=self.preview)
            self._candidates = Stepper(self.plant, self.plant.machine.rate_hz, count), controller
        return self._candidates

    def _put(self, which: Flags, joints: Array, targets: Array) -> None:
        starts = np.clip(joints, self.reach.low, self.reach.high)
        if self.start_swing and isinstance(self._stepper, Stepper):
            self._lane = lane = self._stepper.reset(starts, which=which, swing=self._random_swing(starts))
        else:
            self._lane = lane = self._stepper.reset(starts, which=which)
        self._controller.reset(self._measured(lane)[which], which)
        self._target[which] = targets
        self._view.rest(which)
        self._count[which] = 0

    def _random_swing(self, joints: Array) -> Array:
        """Place [m] and speed [m/s] of the tools, (n, 4), at the beginning of episodes at ``joints`` (n, A)."""
        angle = self._rng.uniform(-math.pi, math.pi, len(joints))
        way = self._rng.uniform(0.0, self.start_swing, len(joints))[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        return np.concatenate([tips(self.model, joints)[:, :2] + way, np.zeros((len(joints), 2))], axis=1)

    def _bounds(self, sign: float) -> Array:
        """Lower or upper bounds of an observation, to scale networks; speeds and sway are typical values, not limits."""
        reach, tuning = self.reach, self._controller.tuning
        joints, ends = (reach.low, reach.ee_low) if sign < 0.0 else (reach.high, reach.ee_high)
        servo = np.array([item.servo for item in tuning], dtype=np.bool_)
        commands = np.where(servo, joints, sign)
        speeds = np.array([(high - low) for low, high in zip(reach.low, reach.high, strict=True)])
        hang = self.plant.effect(gripper_sway.EFFECT.name, "tool")
        length = float(np.atleast_1d(hang.parameters["length"])[0]) if hang is not None else 0.1
        sway, swing = 0.5 * length, 0.5 * math.sqrt(GRAVITY * length)
        below = np.array([sway, sway, 0.0 if sign > 0.0 else length])
        rest = [np.tile(commands, self.history), sign * speeds, sign * below, sign * np.full(3, swing)]
        return np.concatenate([joints, ends, ends, *rest])
