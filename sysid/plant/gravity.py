"""Gravity loads on every axis along a recording, at the measured joints."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.machine import Machine
from sysid.plant.layout import base_place, neutral_vector
from sysid.plant.machine_arrays import links_of
from sysid.plant.pose import loads
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]
Segments = npt.NDArray[np.int64]


def gravity_load(machine: Machine, recording: Recording, within: Segments | None = None) -> Array:
    """Gravity moment about every joint [N·m] or force along it [N], (n, A); above zero where it opposes positive motion.

    From the URDF's masses; of one kilogram at the tip where it has none. Zero without a URDF and where a joint is not measured
    in a whole stretch; gaps of a motion are interpolated. Measured joints contain the sag of their drives, so that the posture
    is the deflected one. The kinematics are nominal: a joint offset and the sag of the structure change loads, and with them
    the sag of the drives, in second order only.

    Args:
        within: (m, 2) first and last+1 row of the stretches to compute; elsewhere the load is zero. All rows by default.
    """
    names = [axis_signal(name, "joint") for name in machine.axis_names]
    axes, links = len(names), links_of(machine.kinematics())
    out, neutral = np.zeros((len(recording), axes)), neutral_vector(axes).copy()
    if len(links) < 2:
        return out
    for first, last in [(0, len(recording))] if within is None else within:
        joints = np.column_stack([recording.values(name)[first:last] for name in names])
        if np.isnan(joints).all(axis=0).any():
            continue
        if recording.kind == "motion":
            rows = np.arange(len(joints))
            for column in joints.T:
                there = ~np.isnan(column)
                column[:] = np.interp(rows, rows[there], column[there])
        loads(neutral, links, base_place(axes), joints, out[first:last])
    return out
