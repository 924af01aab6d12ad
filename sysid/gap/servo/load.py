"""Whether the gravity load of an axis follows from the description of the machine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.datasets.recording import Recording
from sysid.machine import Machine
from sysid.machine.kinematics import Kinematics
from sysid.machine.moved_bodies import has_masses
from sysid.signals import axis_signal

#: Postures of a recording at which the direction of an axis is computed.
POSTURES = 50
#: Largest sine of the angle between an axis that carries no weight and the vertical (the horizontal, if it slides).
TILT = 1e-3


def load_known(machine: Machine, axis: str, recordings: Sequence[Recording]) -> bool:
    """Whether the gravity load of an axis is known: the URDF has masses, or no mass can load the axis.

    No mass loads a joint that turns about the vertical, or slides horizontally, in all recorded postures. A URDF without masses
    gives the load of a unit mass at the tip, which is not that of the machine.
    """
    kinematics = machine.kinematics()
    if kinematics is None:
        return False
    return has_masses(kinematics) or _unloaded(kinematics, machine, axis, recordings)


def _unloaded(kinematics: Kinematics, machine: Machine, axis: str, recordings: Sequence[Recording]) -> bool:
    """Whether the axis keeps the direction in which no weight acts."""
    signals = [axis_signal(name, "joint") for name in machine.axis_names]
    rows = []
    for recording in recordings:
        joints = np.column_stack([recording.values(signal) for signal in signals])
        joints = joints[~np.isnan(joints).any(axis=1)]
        rows.append(joints[:: max(1, len(joints) // POSTURES)])
    postures = np.concatenate(rows) if rows else np.empty((0, len(signals)))
    if not len(postures):
        return False
    joint = kinematics.joints[kinematics.actuated[machine.axis_names.index(axis)]]
    poses = kinematics.link_poses(postures)
    if joint.child not in poses:  # it moves the tip by a passive joint alone
        return False
    upwards = np.abs(poses[joint.child][:, 2, :3] @ joint.axis)
    off = upwards if joint.prismatic else np.sqrt(np.maximum(1.0 - upwards**2, 0.0))
    return bool((off <= TILT).all())
