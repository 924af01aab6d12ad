"""Measured motion of the joints as inputs of the servo axes of an arm, for the run of each by itself (:mod:`.servo_axis`)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.machine import Axis, Machine
from sysid.plant.arm_dynamics import link_series
from sysid.plant.machine_arrays import MachineArrays
from sysid.plant.servo_axis import OWN, PLACE, REST, SERIES, SLOPE, SPEED
from sysid.plant.smooth_motion import second_difference, smooth_motion
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Place of the series in a recording's cache.
_SERIES = "servo series"


def servo_series(machine: Machine, arrays: MachineArrays, recording: Recording) -> Array:
    """Series of all axes of a machine, (A, SERIES, n), in SI units, cached in the recording; missing readings are interpolated.

    A joint that is not measured at all rests at zero; the run of one axis by itself needs those of all others.
    """
    names, key = machine.axis_names, (arrays.links.tobytes(), arrays.bodies.tobytes())
    known: tuple[tuple[bytes, bytes], Array] | None = recording.derived.get(_SERIES)
    if known is not None and known[0] == key:
        return known[1]
    motion = np.zeros((3, len(recording), len(names)))
    for i, name in enumerate(names):
        joint = recording.values(axis_signal(name, "joint"))
        if np.count_nonzero(~np.isnan(joint)) > 1:
            place, speed, acceleration = smooth_motion(joint, recording.rate_hz)
            # Central differences of the first and second order lose (ω·dt)²/6 and (ω·dt)²/12.
            speed = speed - second_difference(speed) / 6.0
            motion[:, :, i] = place, speed, acceleration - second_difference(acceleration) / 12.0
    series = np.zeros((len(names), SERIES, len(recording)))
    series[:, [PLACE, SPEED]] = motion[:2].transpose(2, 0, 1)
    if arrays.bodies[:, 0].any():
        own, rest, slope = np.zeros((3, len(names), len(recording)))
        link_series(arrays.links, arrays.bodies, *motion, own, rest, slope)
        rest = np.apply_along_axis(lambda row: row - second_difference(row) / 12.0, 1, rest)  # so does linear interpolation
        series[:, OWN], series[:, REST], series[:, SLOPE] = own, rest, slope
    recording.derived[_SERIES] = key, series
    return series


def servo_force(axis: Axis, recording: Recording) -> Array:
    """Force of the described controller of a servo axis at its measured motion, (n,) [N·m or N]; NaN where not measured."""
    assert axis.servo is not None
    command, joint = (recording.values(axis_signal(axis.name, part)) for part in ("command", "joint"))
    if np.count_nonzero(~np.isnan(joint)) < 2:
        return np.full(len(joint), np.nan)
    place, speed, _ = smooth_motion(joint, recording.rate_hz)
    return np.clip(axis.servo.kp * (command - place) - axis.servo.kv * speed, *axis.servo.force_range)
