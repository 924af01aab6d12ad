"""The surroundings of the machine: ground and logs, as simple bodies."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

#: Half side and thickness of the ground [m].
GROUND = (25.0, 0.05)


@dataclass(frozen=True)
class Log:
    """A loose horizontal log; a cylinder of constant density.

    Args:
        position: its centre in the machine's frame [m].
        yaw: direction of its axis about the vertical [rad].
        density: [kg/m³]; 700 is fresh pine.
    """

    position: tuple[float, float, float]
    yaw: float = 0.0
    length: float = 0.6
    radius: float = 0.03
    density: float = 700.0

    @property
    def mass(self) -> float:
        return self.density * math.pi * self.radius**2 * self.length


def add_ground(p: Any, client: int, height: float) -> int:
    """Add a wide flat box whose top is at ``height`` [m]; returns the body."""
    side, thick = GROUND
    half = [side, side, 0.5 * thick]
    shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=half, physicsClientId=client)
    look = p.createVisualShape(p.GEOM_BOX, halfExtents=half, rgbaColor=[0.80, 0.82, 0.78, 1.0], physicsClientId=client)
    body = p.createMultiBody(0.0, shape, look, [0.0, 0.0, height - 0.5 * thick], physicsClientId=client)
    p.changeDynamics(body, -1, lateralFriction=0.8, physicsClientId=client)
    return int(body)


def add_log(p: Any, client: int, log: Log) -> int:
    """Add a log at rest; returns the body."""
    shape = p.createCollisionShape(p.GEOM_CYLINDER, radius=log.radius, height=log.length, physicsClientId=client)
    look = p.createVisualShape(
        p.GEOM_CYLINDER, radius=log.radius, length=log.length, rgbaColor=[0.55, 0.40, 0.25, 1.0], physicsClientId=client
    )
    turn = p.getQuaternionFromEuler([0.0, 0.5 * math.pi, log.yaw])
    body = p.createMultiBody(log.mass, shape, look, list(log.position), turn, physicsClientId=client)
    p.changeDynamics(body, -1, lateralFriction=0.7, rollingFriction=1e-3, physicsClientId=client)
    return int(body)
