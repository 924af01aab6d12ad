"""Parts of the drive model around the kernels of the plant, whose source is shipped with them.

A part of the command stage takes one value a step and returns one, and begins as if its first input had been held for a long
time. ``load`` is the gravity load on the drive [N·m or N], positive where it opposes positive motion.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects.backlash import step as backlash_step
from sysid.effects.command_rate_limit import held as command_rate_limit_held
from sysid.effects.command_rate_limit import step as command_rate_limit_step
from sysid.effects.first_order_lag import step as first_order_lag_step
from sysid.effects.gripper_sway import step as gripper_sway_step
from sysid.effects.second_order_lag import deflecting_load as second_order_lag_deflecting_load
from sysid.effects.second_order_lag import follow_load as second_order_lag_follow_load
from sysid.effects.second_order_lag import step as second_order_lag_step
from sysid.effects.sensor_bias import step as sensor_bias_step
from sysid.effects.sensor_quantisation import step as sensor_quantisation_step
from sysid.effects.sensor_scale import step as sensor_scale_step
from sysid.plant.chain import look_up as chain_look_up
from sysid.plant.chain import spool as chain_spool
from sysid.plant.layout import STATE, axis_places, neutral_vector
from sysid.plant.pose import pose as pose_pose

Array = npt.NDArray[np.float64]
#: ``effect.slot`` → its place in the parameters of an axis, and their neutral values; length of its state without the inputs of
#: a delay, and its speed there.
PLACES: dict[str, int] = axis_places()
NEUTRAL: list[float] = neutral_vector(1)[: len(PLACES)].tolist()
REMEMBERED, SPEED = int(STATE.input_delay), int(STATE.speed)


def axis_parameters(effects: dict[str, dict[str, float]]) -> list[float]:
    """The parameters of an axis with these effects."""
    p = list(NEUTRAL)
    for effect, values in effects.items():
        for slot, value in values.items():
            p[PLACES[f"{effect}.{slot}"]] = value
    return p


class Part:
    """One effect of the command stage.

    ``p``: its parameters in the order of ``slots``; ``s``: the ``memory`` numbers that it remembers, NaN before it begins.
    """

    slots: tuple[str, ...] = ()
    memory = 0

    def __init__(self, dt: float, gain: float = 1.0, **values: float) -> None:
        self.dt, self.gain, self.p = dt, gain, [values[slot] for slot in self.slots]
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.s = [math.nan] * self.memory

    def step(self, u: float, load: float) -> float:
        """Output during a step with the input ``u``."""
        raise NotImplementedError

    def hold(self, u: float, load: float) -> float:
        """The same before the first step, with an input that was held for a long time."""
        return self.step(u, load)


class CommandRateLimit(Part):
    """|dy/dt| ≤ rate [1/s, or the unit of a position per s].

    The mean over the step; ``at_end``, the held input with the same effect at the end of the step on a lag of time constant
    ``lag`` [s]: the end of the ramp where there is none.
    """

    slots, memory = ("rate",), 2

    def __init__(self, dt: float, rate: float, at_end: bool = False, lag: float = 0.0) -> None:
        self.at_end, self.lag = at_end, lag
        super().__init__(dt, rate=rate)

    def step(self, u: float, load: float) -> float:
        if self.at_end:
            return float(command_rate_limit_held(u, self.lag, self.p, 0, self.s, 0, self.dt))
        return float(command_rate_limit_step(u, self.p, 0, self.s, 0, self.dt))


class FirstOrderLag(Part):
    """T·dx/dt = u − x, exact for a held input: the mean over the step, or the value at its end; T in seconds."""

    slots, memory = ("time_constant",), 3

    def __init__(self, dt: float, time_constant: float, at_end: bool = False) -> None:
        self.at_end = at_end
        super().__init__(dt, time_constant=time_constant)

    def step(self, u: float, load: float) -> float:
        mean = float(first_order_lag_step(u, self.p, 0, self.s, 0, self.dt))
        return self.s[0] if self.at_end else mean


class SecondOrderLag(Part):
    """T²·ẍ + 2ζT·ẋ + x = u, exact for a held input: the value at the end of the step; T in seconds.

    The load follows through the same loop (``sag_load``), since the sag of a servo is an error of its loop.
    """

    slots, memory = ("time_constant", "damping_ratio"), 8

    def step(self, u: float, load: float) -> float:
        second_order_lag_follow_load(load, self.p, 0, self.s, 0, self.dt)
        return float(second_order_lag_step(u, self.p, 0, self.s, 0, self.dt))

    def sag_load(self, load: float) -> float:
        """The load under which the servo sags; ``load`` itself before the first step."""
        return float(second_order_lag_deflecting_load(load, self.p, 0, self.s, 0))


class StickingSpool(Part):
    """Dead time, ramp and lag of a spool that sticks at its centre; ``effects``: these and its edges, with their numbers."""

    def __init__(self, dt: float, effects: dict[str, dict[str, float]]) -> None:
        delay = effects.get("input_delay", {"delay": 0.0})["delay"]
        self.memory = REMEMBERED + math.ceil(delay / dt) + 6
        super().__init__(dt)
        self.p = axis_parameters(effects)

    def step(self, u: float, load: float) -> float:
        return float(chain_spool(u, self.p, 0, self.s, 0, self.memory, self.dt))


class NominalGain(Part):
    """Command → speed: gain·x [m/s or rad/s]."""

    def step(self, u: float, load: float) -> float:
        return self.gain * u


class Linkage:
    """Cylinder displacement [m] → joint [rad or m]: an even table, extended along its end slopes."""

    def __init__(self, low: float, step: float, joints: list[float]) -> None:
        self.low, self.spacing, self.joints = low, step, joints

    def joint(self, x: float) -> float:
        return float(chain_look_up(x, [self.joints], 0, self.low, self.spacing))

    def displacement(self, joint: float) -> float:
        """The inverse, inside the table."""
        rising = 1.0 if self.joints[-1] > self.joints[0] else -1.0
        places = self.low + self.spacing * np.arange(len(self.joints))
        return float(np.interp(rising * joint, rising * np.asarray(self.joints), places))


class Backlash:
    """y = min(max(y, x − width/2), x + width/2) [rad or m]."""

    def __init__(self, width: float) -> None:
        self.p = [width]
        self.reset(math.nan)

    def reset(self, y: float) -> None:
        self.s = [y]

    def step(self, x: float) -> float:
        return float(backlash_step(x, self.p, 0, self.s, 0))


class Kinematics:
    """Chain of joints from base to tip.

    Args:
        joints: of each the ``rotation`` (3, 3) and ``shift`` (3) [m] of its frame in the frame that the joint before it moves,
            its ``axis`` (3), whether it is ``prismatic``, which machine ``axis_index`` moves it, with ``ratio`` and ``offset``,
            and ``mass`` [kg] and ``centre`` (3) [m] of all that moves with it and no further joint.
        tip: place of the tip in the frame that the last joint moves (3) [m].
        base_rotation, base_translation: model → measured frame, (3, 3) and (3) [m].
    """

    def __init__(self, joints: list[Any], tip: list[float], base_rotation: list[Any], base_translation: list[float]) -> None:
        rows = []
        for joint in joints:
            frame = [x for row in joint["rotation"] for x in row] + joint["shift"] + joint["axis"] + [0.0, 1.0]
            body = [float(joint["prismatic"]), joint["axis_index"], joint["mass"], *joint["centre"], 0.0]
            rows.append([*frame, *body, joint["ratio"], joint["offset"], 1.0, GRAVITY])
        self.links = [*rows, [*[0.0] * 9, *tip, *[0.0] * 16]]
        self.none, self.scratch = [0.0] * 16, [[0.0] * 8 for _ in self.links]  # no further effects; a working space
        self.base_rotation, self.base_translation = np.array(base_rotation), np.array(base_translation)

    def pose(self, q: list[float]) -> tuple[Array, Array]:
        """Joints of the structure (A,) → end effector (3,) [m] and gravity load of each axis (A,) [N·m or N]."""
        tip, load = [0.0] * 3, [0.0] * len(q)
        pose_pose(q, self.none, self.links, 0, self.scratch, tip, load)
        return self.base_rotation @ np.array(tip) + self.base_translation, np.array(load)


class SensorReading:
    """step·⌊(scale·x + bias)/step + ½⌋; without rounding for a step of zero."""

    def __init__(self, scale: float, bias: float, step: float) -> None:
        self.p = [scale, bias, step]

    def read(self, x: float) -> float:
        y = sensor_bias_step(sensor_scale_step(x, self.p, 0), self.p, 1)
        return float(sensor_quantisation_step(y, self.p, 2))


class GripperSway:
    """A tool that hangs ``length`` [m] below the tip on two passive joints: a damped spherical pendulum."""

    def __init__(self, dt: float, length: float, damping_ratio: float) -> None:
        self.dt, self.p = dt, [length, damping_ratio]
        self.reset()

    def reset(self) -> None:
        self.s = [math.nan] * 10

    def step(self, pivot: Array) -> Array:
        """Tip (3,) → tool (3,); the pivot moves evenly during the step."""
        tool = [0.0] * 3
        gripper_sway_step(*map(float, pivot), self.p, 0, self.s, 0, self.dt, tool)
        return np.array(tool)


#: Standard gravity [m/s²], along −z of the base.
GRAVITY = 9.80665
