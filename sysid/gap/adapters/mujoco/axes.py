"""The axes of a machine in an MJCF: joint, actuator, and the control that each command means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sysid.errors import SettingsError, nearest
from sysid.foreign import shown
from sysid.machine import Machine
from sysid.machine.sources.mjcf_actuator import Drive, drive_of
from sysid.machine.sources.mjcf_model import actuator_name, body_name, joint_actuators, joint_name, mujoco_library
from sysid.names import listed


@dataclass(frozen=True)
class Point:
    """The place of ``ee`` or ``tool``: a site or the origin of a body, with its MuJoCo object type."""

    kind: int
    name: str


def drives_of(model: Any, machine: Machine, source: str) -> tuple[Drive, ...]:
    """The drive of each axis, in the order of the machine.

    Raises:
        SettingsError: an axis without its joint or actuator, or with another kind of command.
    """
    joints = {joint_name(model, k): k for k in range(model.njnt)}
    actuators, found = joint_actuators(model), []
    for axis in machine.axes:
        where = f"{source}: axis {shown(axis.name)}"
        name = axis.joint or axis.name
        if axis.drives != "joint":
            raise SettingsError(where, "it drives a cylinder", "joint axes, which MJCF has")
        if name not in joints:
            raise SettingsError(where, f"no joint {name!r} in the model", nearest(name, joints))
        own = actuators.get(joints[name], [])
        if len(own) != 1:
            names = f"actuators {listed([actuator_name(model, k) for k in own])}" if own else "no actuator"
            raise SettingsError(where, f"{names} on joint {name!r}", "one actuator")
        drive = drive_of(model, own[0], source)
        led = drive.actuation == "position" and axis.follows_positions
        if drive.actuation != axis.actuation and not led:
            found_as = f"actuator {actuator_name(model, own[0])} takes a {drive.control}, machine.toml says {axis.actuation}"
            remedy = f"sysid init --from {source} makes the machine.toml of this model."
            raise SettingsError(where, found_as, "the same actuation in both", remedy)
        found.append(drive)
    return tuple(found)


def point_of(model: Any, link: str | None, source: str) -> Point | None:
    """The site or body that a URDF link of ``machine.toml`` names; None without a link.

    Raises:
        SettingsError: the model has neither a site nor a body of that name.
    """
    if link is None:
        return None
    kinds = mujoco_library().mjtObj
    sites = [str(model.site(k).name) for k in range(model.nsite)]
    bodies = [body_name(model, k) for k in range(1, model.nbody)]
    for name in (link, link.removesuffix("_tip")):  # the suffix of a fixed link beside a body of that name
        if name in sites:
            return Point(int(kinds.mjOBJ_SITE), name)
        if name in bodies:
            return Point(int(kinds.mjOBJ_XBODY), name)
    raise SettingsError(f"{source}: link {shown(link)} of machine.toml", "no site or body", nearest(link, [*sites, *bodies]))


def idle_controls(model: Any, drives: Sequence[Drive]) -> Any:
    """Controls (nu,) of actuators beside the axes: those of the first keyframe, else zero."""
    import numpy as np

    return np.array(model.key_ctrl[0]) if model.nkey else np.zeros(model.nu)
