"""An arm of servo axes in the vertical plane.

A drive follows its commanded position like an inner speed loop: with delay, lag and rate limit, and with a steady-state error
by friction over stiffness; behind it come backlash and the sag of the structure.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled
from simulated_bench.drivetrain import follow_with_backlash
from simulated_bench.excursions import draw_path
from simulated_bench.joint_recipe import STEP, ServoArm, Take
from simulated_bench.valve import delayed, spool_step

Array = npt.NDArray[np.float64]

GRAVITY = 9.81


def run_servo_arm(arm: ServoArm, take: Take) -> tuple[Array, Array, Array]:
    """Time (n,) [s], commanded and true joints (n, axes) [rad] at the log's rate, without noise."""
    rng = np.random.default_rng([arm.seed, take.seed])
    cycle = 1.0 / arm.rate
    ticks = round(take.seconds * arm.rate)
    setpoint = np.stack([draw_path(axis.limits, ticks, cycle, rng) for axis in arm.axes], axis=1)
    per_cycle = round(cycle / STEP)
    drives = np.empty_like(setpoint)
    joints = np.empty_like(setpoint)
    for i, axis in enumerate(arm.axes):
        _servo(
            np.ascontiguousarray(setpoint[:, i]),
            (axis.delay, min(axis.rate_limit, 1e9), axis.time_constant, axis.standing_error, axis.backlash),
            cycle,
            per_cycle,
            drives[:, i],
        )
    joints[:] = drives
    for i, axis in enumerate(arm.axes):
        if axis.eccentricity != 0.0:
            joints[:, i] += axis.eccentricity * np.sin(axis.teeth * drives[:, i])
    moments = gravity_moments(arm, drives)
    for i, axis in enumerate(arm.axes):
        joints[:, i] -= axis.compliance * moments[:, i]
    return np.arange(ticks, dtype=np.float64) * cycle, setpoint, joints


def gravity_moments(arm: ServoArm, joints: Array) -> Array:
    """Moment of the weights about every joint, positive where it pulls down a horizontal arm, (n, axes) [N·m]."""
    pitch = np.cumsum(joints, axis=1)
    lengths = np.array([axis.length for axis in arm.axes])
    masses = np.array([axis.mass for axis in arm.axes])
    reach = lengths * np.cos(pitch)
    centres = np.cumsum(reach, axis=1) - 0.5 * reach
    bases = np.cumsum(reach, axis=1) - reach
    found = np.empty_like(joints)
    for i in range(len(arm.axes)):
        found[:, i] = GRAVITY * np.sum(masses[i:] * (centres[:, i:] - bases[:, i : i + 1]), axis=1)
    return found


@compiled
def _servo(setpoint: Array, servo: tuple[float, float, float, float, float], cycle: float, per_cycle: int, out: Array) -> None:
    delay, rate_limit, time_constant, standing_error, play = servo
    limited = setpoint[0]
    drive = setpoint[0]
    filtered = setpoint[0]
    structure = setpoint[0]
    for k in range(len(setpoint)):
        out[k] = structure
        for j in range(per_cycle):
            time = k * cycle + j * STEP
            target = delayed(setpoint[: k + 1], cycle, time, STEP, delay)
            limited += min(max(target - limited, -rate_limit * STEP), rate_limit * STEP)
            filtered, _ = spool_step(filtered, limited, STEP, time_constant)
            # Friction holds the drive until the controller's force exceeds it.
            drive = follow_with_backlash(drive, filtered, 2.0 * standing_error)
            structure = follow_with_backlash(structure, drive, play)
