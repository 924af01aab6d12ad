"""An arm of servo axes in the vertical plane.

A drive follows its commanded position as an inner speed loop does: late, no faster than its rate limit, and it stops short by
what friction holds against its stiffness; behind it come play and the sag of the structure.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.bench.compiled import compiled
from sysid.bench.drivetrain import follow_with_play
from sysid.bench.excursions import draw_path
from sysid.bench.joint_recipe import STEP, ServoArm, Take
from sysid.bench.valve import delayed, spool_step

Array = npt.NDArray[np.float64]

GRAVITY = 9.81


def run_servo_arm(arm: ServoArm, take: Take) -> tuple[Array, Array, Array]:
    """Time (n,) [s], commanded and true joints (n, axes) [rad] at the log's rate, without noise."""
    rng = np.random.default_rng([arm.seed, take.seed])
    cycle = 1.0 / arm.rate
    ticks = round(take.seconds * arm.rate)
    wanted = np.stack([draw_path(axis.limits, ticks, cycle, rng) for axis in arm.axes], axis=1)
    per_cycle = round(cycle / STEP)
    drives = np.empty_like(wanted)
    joints = np.empty_like(wanted)
    for i, axis in enumerate(arm.axes):
        _servo(
            np.ascontiguousarray(wanted[:, i]),
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
    return np.arange(ticks, dtype=np.float64) * cycle, wanted, joints


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
def _servo(wanted: Array, servo: tuple[float, float, float, float, float], cycle: float, per_cycle: int, out: Array) -> None:
    delay, rate_limit, time_constant, standing, play = servo
    limited = wanted[0]
    drive = wanted[0]
    filtered = wanted[0]
    structure = wanted[0]
    for k in range(len(wanted)):
        out[k] = structure
        for j in range(per_cycle):
            time = k * cycle + j * STEP
            target = delayed(wanted[: k + 1], cycle, time, STEP, delay)
            limited += min(max(target - limited, -rate_limit * STEP), rate_limit * STEP)
            filtered, _ = spool_step(filtered, limited, STEP, time_constant)
            # Friction holds the drive until the controller's pull exceeds it: it trails its target by that much.
            drive = follow_with_play(drive, filtered, 2.0 * standing)
            structure = follow_with_play(structure, drive, play)
