"""Constant arrays of a machine for the compiled kernels, beside its parameters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sysid.machine import Axis, Kinematics
from sysid.machine.moved_bodies import PARAMETERS, moved_bodies, moved_inertias
from sysid.plant import layout
from sysid.plant.plant import Plant

Array = npt.NDArray[np.float64]

VELOCITY, POSITION, FORCE, SERVO = 0, 1, 2, 3
KINDS = {"velocity": VELOCITY, "position": POSITION, "force": FORCE, "servo": SERVO}
#: Inertia of a rotor that the machine's description does not state [kg or kg·m²].
NO_INERTIA = 1e-9
#: Points of a linkage table.
_POINTS = 2048

# Columns of ``MachineArrays.axes``.
KIND, GAIN, LOW, HIGH, CYLINDER, SENSE, TABLE_LOW, TABLE_STEP = range(8)
STIFFNESS, DAMPING, LOWEST, HIGHEST, LEAD, IMPLICIT, GIVE, GIVE_TIME = range(8, 16)
# Columns of ``MachineArrays.links``: rotation (9, row by row) and translation (3) of the joint's frame in the frame that the
# joint before it moves, its axis (3), and so on; the last row leads on to the tip.
ROTATION, SHIFT, AXIS, ALIGNED, TURNED, PRISMATIC, ORDER, MASS, CENTRE, LENGTH = 0, 9, 12, 15, 16, 17, 18, 19, 20, 23
RATIO, OFFSET, PASSIVE, WEIGHT = 24, 25, 26, 27
LINK_WIDTH = 28


class MachineArrays(NamedTuple):
    """Constant arrays of a machine with A axes and J joints in its chain (J = 0 without a URDF).

    Few arrays with many columns: the compiled code counts references to each of them.

    Args:
        axes: (A, 16): kind of actuation; gain, or inertia of a force axis, or armature of a servo axis; low and high end stop
            of what the command drives; whether that is a cylinder; +1 where the joint rises with it, −1 where it falls; low end
            and step of its table; of a servo axis stiffness, damping, lowest and highest force of its controller, half the step
            of the simulator [s], +1 where that is implicit in the damping, else −1, and how its dry friction gives way: speed a
            force and time [s].
        tables: joint over an even grid of the cylinder, (A, points), NaN without a linkage.
        links: (J + 1, 28): frame and axis of each joint; ``ALIGNED`` 1, 2, 3 for an axis along +x, +y, +z, negative for −,
            else 0; whether the frame is turned at all; whether the joint is prismatic; which axis moves it; mass and centre
            of all that moves with it and no further joint; length of the translation; ratio and offset of the joint's value
            to that of its axis, and whether it is a passive joint that follows it; gravity [m/s²], the same in each row.
        bodies: (J, 10): inertial parameters of all that moves with each joint and no further one, about the origin of the
            joint and in its frame (:func:`sysid.machine.moved_bodies.moved_inertias`).
        machine, base, tool: indices at which their blocks begin in ``theta``.
    """

    axes: Array
    tables: Array
    links: Array
    bodies: Array
    machine: int
    base: int
    tool: int

    @property
    def posed(self) -> bool:
        """Whether the machine has kinematics."""
        return len(self.links) > 1


def machine_arrays(plant: Plant) -> MachineArrays:
    """The arrays of a plant."""
    machine = plant.machine
    count = len(machine.axes)
    axes, tables = np.zeros((count, GIVE_TIME + 1)), np.full((count, _POINTS), np.nan)
    axes[:, KIND] = [KINDS[axis.actuation] for axis in machine.axes]
    axes[:, GAIN] = [_gain(axis) for axis in machine.axes]
    for its, axis in zip(axes, machine.axes, strict=True):
        if axis.servo is not None:
            law = axis.servo
            its[STIFFNESS : HIGHEST + 1] = law.kp, law.kv, *law.force_range
            its[LEAD], its[IMPLICIT] = 0.5 * law.step, 1.0 if law.implicit else -1.0
            its[GIVE], its[GIVE_TIME] = law.friction_give, law.friction_time
    axes[:, [LOW, HIGH]] = [axis.range for axis in machine.axes]
    axes[:, CYLINDER] = [axis.drives == "cylinder" for axis in machine.axes]
    axes[:, [SENSE, TABLE_LOW, TABLE_STEP]] = 1.0, 0.0, 1.0
    for name, linkage in plant.linkages.items():
        row = machine.axis_names.index(name)
        first, last = float(linkage.displacements[0]), float(linkage.displacements[-1])
        tables[row] = linkage.joint(np.linspace(first, last, _POINTS))
        axes[row, [SENSE, TABLE_LOW, TABLE_STEP]] = (
            np.sign(tables[row, -1] - tables[row, 0]),
            first,
            (last - first) / (_POINTS - 1),
        )
    places = layout.machine_place(count), layout.base_place(count), layout.tool_place(count)
    kinematics = machine.kinematics()
    bodies = np.zeros((0, PARAMETERS))
    if kinematics is not None and machine.urdf_text is not None:
        bodies = moved_inertias(kinematics, machine.urdf_text)
    return MachineArrays(axes, tables, links_of(kinematics), bodies, *places)


def _gain(axis: Axis) -> float:
    """``MachineArrays.axes[GAIN]``."""
    if axis.actuation == "servo":
        return axis.inertia or 0.0
    return float(axis.inertia or NO_INERTIA) if axis.actuation == "force" else axis.gain


def links_of(kinematics: Kinematics | None) -> Array:
    """``MachineArrays.links`` of a kinematic chain, fixed joints merged."""
    if kinematics is None:
        return np.zeros((1, LINK_WIDTH))
    rows: list[Array] = []
    frame = np.eye(4)
    for joint in kinematics.chain:
        frame = frame @ joint.origin
        drive = kinematics.drives.get(joint.name)
        if drive is not None:
            row = _row(frame)
            row[AXIS : AXIS + 3], row[ALIGNED] = joint.axis, _aligned(joint.axis)
            row[PRISMATIC], row[ORDER] = joint.prismatic, drive.column
            row[RATIO], row[OFFSET], row[PASSIVE] = drive.ratio, drive.offset, joint.name not in kinematics.actuated
            rows.append(row)
            frame = np.eye(4)
    for row, body in zip(rows, moved_bodies(kinematics), strict=True):
        row[MASS], row[CENTRE : CENTRE + 3] = body.mass, body.centre
    found = np.array([*rows, _row(frame)])
    found[:, WEIGHT] = kinematics.gravity
    return found


def _row(frame: Array) -> Array:
    row = np.zeros(LINK_WIDTH)
    row[ROTATION : ROTATION + 9], row[SHIFT : SHIFT + 3] = frame[:3, :3].ravel(), frame[:3, 3]
    row[TURNED], row[LENGTH] = not np.array_equal(frame[:3, :3], np.eye(3)), np.linalg.norm(frame[:3, 3])
    return row


def _aligned(axis: Array) -> int:
    k = int(np.argmax(np.abs(axis)))
    return int(np.sign(axis[k])) * (k + 1) if abs(axis[k]) == 1.0 else 0
