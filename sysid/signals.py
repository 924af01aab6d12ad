"""Canonical signal names: ``boom.command``, ``boom.cylinder``, ``boom.joint``, ``boom.speed``, ``ee.x`` …, ``tool.x`` …"""

from __future__ import annotations

#: What follows the axis name, in the order of the signal chain. The speed is that of the quantity that the command drives.
AXIS_QUANTITIES = ("command", "cylinder", "joint", "speed")
POINTS = ("ee", "tool")


def split_signal(signal: str) -> tuple[str, str]:
    """``"boom.joint"`` → ``("boom", "joint")``; ``"ee.x"`` → ``("ee", "x")``."""
    owner, _, quantity = signal.rpartition(".")
    return owner, quantity


def axis_signal(axis: str, quantity: str) -> str:
    """``("boom", "joint")`` → ``"boom.joint"``."""
    return f"{axis}.{quantity}"


def point_signals(point: str) -> tuple[str, str, str]:
    """``"ee"`` → ``("ee.x", "ee.y", "ee.z")``."""
    return f"{point}.x", f"{point}.y", f"{point}.z"


def canonical_signals(axes: tuple[str, ...], markers: tuple[str, ...] = ()) -> tuple[str, ...]:
    """All signal names of a machine with these axes and markers, without ``time``."""
    per_axis = [axis_signal(axis, quantity) for axis in axes for quantity in AXIS_QUANTITIES]
    return (*per_axis, *(signal for point in (*POINTS, *markers) for signal in point_signals(point)))
