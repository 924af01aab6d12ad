"""Robots in MJCF: a servo arm, an arm of motors, a crane of speed-controlled drives."""

from __future__ import annotations

from pathlib import Path

ROBOTS = ("servo_arm", "torque_arm", "velocity_crane")


def robot(name: str) -> Path:
    """Path of the MJCF of one of :data:`ROBOTS`."""
    return Path(__file__).with_name(f"{name}.xml")
