"""Parts of the drawing of a machine, each an SVG fragment (``hot`` parts are highlighted), and the placement of labels beside
them, without overlap.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Height of the row of an axis that has no geometry [px].
PARTS_HEIGHT = 54.0


def base(at: Array, hot: bool) -> str:
    """The foot of the machine on the ground."""
    x, y = at
    ticks = "".join(
        f'<line x1="{x + i:.1f}" y1="{y + 8:.1f}" x2="{x + i - 7:.1f}" y2="{y + 16:.1f}"/>' for i in range(-28, 36, 12)
    )
    look = "base hot" if hot else "base"
    plate = f'<rect class="{look}" x="{x - 30:.1f}" y="{y - 8:.1f}" width="60" height="16" rx="3"/>'
    return f'<g class="ground"><line x1="{x - 44:.1f}" y1="{y + 8:.1f}" x2="{x + 44:.1f}" y2="{y + 8:.1f}"/>{ticks}</g>{plate}'


def link(a: Array, b: Array, thin: bool) -> str:
    """A link, or the thin part of a telescope; empty if it has no length."""
    if float(np.hypot(*(b - a))) < 1.0:
        return ""
    return f'<line class="link{" thin" if thin else ""}" {_ends(a, b)}/>'


def joint(at: Array, prismatic: bool, vertical: bool, hot: bool) -> str:
    """A joint: round if revolute, square if prismatic, with a ring if its axis is vertical."""
    x, y = at
    look = "joint hot" if hot else "joint"
    if prismatic:
        return f'<rect class="{look}" x="{x - 7:.1f}" y="{y - 7:.1f}" width="14" height="14" rx="2"/>'
    ring = f'<ellipse class="turn" cx="{x:.1f}" cy="{y:.1f}" rx="20" ry="6.5"/>' if vertical else ""
    return f'{ring}<circle class="{look}" cx="{x:.1f}" cy="{y:.1f}" r="8"/>'


def cylinder(rear: Array, front: Array, hot: bool) -> str:
    """Barrel from ``rear``, rod to ``front``, an eye at both ends."""
    along = (front - rear) / max(float(np.hypot(*(front - rear))), 1e-9)
    length = float(np.hypot(*(front - rear)))
    x, y = rear
    angle = float(np.degrees(np.arctan2(along[1], along[0])))
    look = "barrel hot" if hot else "barrel"
    barrel = f'<rect class="{look}" x="6" y="-7" width="{0.58 * length - 6:.1f}" height="14" rx="2"/>'
    rod = f'<line class="rod" x1="{0.58 * length:.1f}" y1="0" x2="{length:.1f}" y2="0"/>'
    eyes = f'<circle class="eye" cx="0" cy="0" r="4"/><circle class="eye" cx="{length:.1f}" cy="0" r="4"/>'
    return f'<g transform="translate({x:.1f} {y:.1f}) rotate({angle:.1f})">{rod}{barrel}{eyes}</g>'


def valve(at: Array, hot: bool) -> str:
    """A proportional directional valve: three boxes, crossed arrows left, parallel ones right, closed in the middle."""
    x, y = at
    look = "valve hot" if hot else "valve"
    boxes = "".join(f'<rect x="{k * 12 - 18}" y="-7" width="12" height="14"/>' for k in range(3))
    flow = '<path d="M-15,-4 L-9,4 M-9,-4 L-15,4 M9,-4 L9,4 M15,-4 L15,4"/>'
    closed = '<path d="M-3,-7 L-3,-3 M-5,-3 L-1,-3 M3,-7 L3,-3 M1,-3 L5,-3"/>'
    return f'<g class="{look}" transform="translate({x:.1f} {y:.1f}) scale(1.25)">{boxes}{flow}{closed}</g>'


def drive(at: Array, hot: bool) -> str:
    """A motor or servo."""
    x, y = at
    look = "motor hot" if hot else "motor"
    return (
        f'<g class="{look}"><circle cx="{x:.1f}" cy="{y:.1f}" r="11"/>'
        f'<text x="{x:.1f}" y="{y + 4.5:.1f}" text-anchor="middle">M</text></g>'
    )


def pump(at: Array, part: str) -> str:
    """Pump or clock beside the machine, with its name under it."""
    x, y = at
    inside = (
        f'<path class="fill" d="M{x - 6:.1f},{y - 9:.1f} L{x + 6:.1f},{y - 9:.1f} L{x:.1f},{y - 17:.1f} z"/>'
        if part == "pump"
        else f'<path d="M{x:.1f},{y - 11:.1f} L{x:.1f},{y:.1f} L{x + 8:.1f},{y + 5:.1f}"/>'
    )
    label = f'<text class="axis" x="{x:.1f}" y="{y + 38:.1f}" text-anchor="middle">{escape(part)}</text>'
    return f'<g class="aside"><circle cx="{x:.1f}" cy="{y:.1f}" r="18"/>{inside}</g>{label}'


def tool(tip: Array, at: Array, hot: bool) -> str:
    """The tool on its cable."""
    look = " hot" if hot else ""
    x, y = at
    return f'<line class="cable{look}" {_ends(tip, at)}/><circle class="tool{look}" cx="{x:.1f}" cy="{y:.1f}" r="9"/>'


def pipe(actuator: Array, at: Array) -> str:
    """The line from an actuator to its valve or motor."""
    return f'<line class="pipe" {_ends(actuator, at)}/>'


def name(text: str, at: Array) -> str:
    """The name of an axis, its middle at ``at``."""
    return f'<text class="axis" x="{at[0]:.1f}" y="{at[1] + 5:.1f}" text-anchor="middle">{escape(text)}</text>'


def badge(part: Array, at: Array, number: int, sure: bool, radius: float) -> str:
    """A number beside its part, with a line to it."""
    look = "badge" if sure else "badge open"
    line = f'<line class="leader" {_ends(part, at)}/>' if float(np.hypot(*(at - part))) > radius else ""
    circle = f'<circle class="{look}" cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{radius:.0f}"/>'
    text = f'<text class="{look}" x="{at[0]:.1f}" y="{at[1] + 5:.1f}" text-anchor="middle">{number}</text>'
    return line + circle + text


def _ends(a: Array, b: Array) -> str:
    return f'x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}"'


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
