"""Parts of the drawing of a machine, each an SVG fragment; ``hot`` parts are highlighted."""

from __future__ import annotations

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
