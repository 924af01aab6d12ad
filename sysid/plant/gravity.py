"""Gravity loads along a recording: what every axis has to carry at the measured joints."""

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
    in a whole stretch; gaps of a motion are bridged linearly. The nominal kinematics are used: what a joint offset changes is
    second order.

    Args:
        within: (m, 2) first and last+1 row of the stretches that matter; elsewhere it is zero. All of them by default.
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


def measured_joints(recording: Recording, machine: Machine) -> Array:
    """All joints (n, A)."""
    return np.column_stack([recording.values(axis_signal(name, "joint")) for name in machine.axis_names])
