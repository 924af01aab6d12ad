"""Placement of labels on a drawing, beside their parts and without overlap."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Number of tried directions, and cost of a pixel of distance from the part, in pixels of clearance.
DIRECTIONS, DISTANCE_COST = 24, 0.6
#: Cost of an overlap [px], larger than any distance.
OVERLAP_COST = 100.0
#: Clearance beyond this value has no further benefit [px].
ENOUGH = 9.0


class Canvas:
    """A drawing of a given size [px] with its occupied points."""

    def __init__(self, width: float, height: float) -> None:
        self.size = np.array([width, height])
        self._taken: list[Array] = []

    def line(self, a: Array, b: Array, half: float = 0.0) -> None:
        """Occupy a line of half width ``half``."""
        along = b - a
        length = max(float(np.hypot(*along)), 1e-9)
        across = np.array([-along[1], along[0]]) / length
        for t in np.linspace(0.0, 1.0, max(2, math.ceil(length / 5.0))):
            for side in (-half, half) if half > 0.0 else (0.0,):
                self._taken.append(a + t * along + side * across)

    def box(self, at: Array, half: tuple[float, float]) -> None:
        """Occupy a rectangle around ``at``."""
        for x in np.linspace(-half[0], half[0], max(2, math.ceil(half[0] / 3.0))):
            for y in np.linspace(-half[1], half[1], max(2, math.ceil(half[1] / 3.0))):
                self._taken.append(at + np.array([x, y]))

    def clearance(self, at: Array, half: tuple[float, float]) -> float:
        """Distance from a rectangle around ``at`` to occupied points and the edges; negative for an overlap."""
        edge = float(np.min([*(at - half), *(self.size - at - half)])) - 2.0
        if not self._taken:
            return edge
        away = np.abs(np.array(self._taken) - at) - np.array(half)
        outside = np.hypot(*np.maximum(away, 0.0).T)
        inside = np.minimum(np.max(away, axis=1), 0.0)
        return min(edge, float(np.min(outside + inside)))

    def place(self, anchor: Array, half: tuple[float, float], distances: Sequence[float]) -> Array:
        """The best centre for a rectangle beside ``anchor``, which is then occupied."""
        best, score = anchor, -math.inf
        for distance in distances:
            for k in range(DIRECTIONS):
                angle = 2.0 * math.pi * k / DIRECTIONS
                direction = np.array([math.cos(angle), -math.sin(angle)])
                # The distance is to the edge of the rectangle.
                centre = anchor + direction * (distance + abs(direction[0]) * half[0] + abs(direction[1]) * half[1])
                room = min(self.clearance(centre, half), ENOUGH)
                value = room - DISTANCE_COST * distance - (OVERLAP_COST if room < 0.0 else 0.0)
                if value > score + 1e-9:
                    best, score = centre, value
        self.box(best, half)
        return np.asarray(best)
