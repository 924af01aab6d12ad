"""The machine as a line drawing (inline SVG), with the places marked where effects were found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
import numpy.typing as npt

from sysid.machine import Axis, Kinematics, Machine

Array = npt.NDArray[np.float64]

WIDTH, HEIGHT, MARGIN = 760, 400, 46
#: The right part of the drawing is kept free for the call-outs.
DRAWING_WIDTH = 500
LABEL_X = DRAWING_WIDTH + 38
LINE = 20.0


@dataclass(frozen=True)
class Callout:
    """A mark on the drawing: ``target`` is an axis, ``ee``, ``tool``, ``base`` or ``machine``; a line of text a title."""

    target: str
    titles: tuple[str, ...]
    detail: str = ""

    @property
    def height(self) -> float:
        """Room that its text takes [px]."""
        return LINE * len(self.titles) + 40.0


def machine_picture(machine: Machine, callouts: Sequence[Callout]) -> str:
    """Side view of the machine's chain with call-outs; a row of axes where the machine has no URDF."""
    kinematics = machine.kinematics()
    if kinematics is None or not kinematics.chain:
        return _axis_row(machine.axes, callouts)
    return _side_view(machine, kinematics, callouts)


def _side_view(machine: Machine, kinematics: Kinematics, callouts: Sequence[Callout]) -> str:
    poses = {link: pose[0] for link, pose in kinematics.link_poses(_middle(machine, kinematics)).items()}
    points = [poses[kinematics.chain[0].parent][:3, 3], *(poses[joint.child][:3, 3] for joint in kinematics.chain)]
    # Where a telescope leaves the link that carries it: the thick part of the drawing ends there.
    sleeves = [(poses[joint.parent] @ joint.origin)[:3, 3] for joint in kinematics.chain]
    tool = _tool_point(kinematics, points[-1])
    if tool is not None:
        points.append(tool)
    every = _fit_to_page(_project(np.array([*points, *sleeves])))
    at, sleeve_at = every[: len(points)], every[len(points) :]
    chain = at[: len(kinematics.chain) + 1]
    place = {"base": at[0], "machine": at[0], "ee": chain[-1]}
    if tool is not None:
        place["tool"] = at[-1]
    for axis in machine.axes:
        index = next(i for i, joint in enumerate(kinematics.chain) if joint.name == axis.joint)
        # A prismatic joint is marked in the middle of what it extends, a revolute one where it turns.
        end = chain[index + 1]
        place[axis.name] = 0.5 * (sleeve_at[index] + end) if kinematics.chain[index].prismatic else end
    marked = {callout.target for callout in callouts}
    parts = [_ground(at[0]), *_leaders(callouts, place)]
    for i in range(len(kinematics.chain)):
        parts += [_link(chain[i], sleeve_at[i], thin=False), _link(sleeve_at[i], chain[i + 1], thin=True)]
    if tool is not None:
        hot = " hot" if "tool" in marked else ""
        parts.append(f'<line class="cable{hot}" {_ends(chain[-1], at[-1])}/>')
        parts.append(f'<circle class="tool{hot}" cx="{at[-1][0]:.1f}" cy="{at[-1][1]:.1f}" r="9"/>')
    for axis in machine.axes:
        joint = next(joint for joint in kinematics.chain if joint.name == axis.joint)
        vertical = not joint.prismatic and abs((poses[joint.child][:3, :3] @ joint.axis)[2]) > 0.9
        parts.append(_joint_mark(place[axis.name], joint.prismatic, vertical, axis.name in marked))
    parts.append(f'<circle class="tip" cx="{chain[-1][0]:.1f}" cy="{chain[-1][1]:.1f}" r="4"/>')
    parts += [_name(axis.name, place[axis.name], at) for axis in machine.axes if axis.name not in marked]
    parts += _labels(callouts, place)
    return _svg(parts, f"Side view of {machine.name}", HEIGHT)


def _middle(machine: Machine, kinematics: Kinematics) -> Array:
    """Every axis in the middle of its range; an unlimited one at zero. Shape (1, n_axes)."""
    values = []
    for axis in machine.axes:
        low, high = axis.limits or kinematics.limits(axis.joint or "")
        values.append(0.5 * (low + high) if math.isfinite(low + high) else 0.0)
    return np.array([values])


def _tool_point(kinematics: Kinematics, tip: Array) -> Array | None:
    """Where the tool hangs below the tip: the length of the joints between them, straight down."""
    if kinematics.tool is None or kinematics.tool == kinematics.tip:
        return None
    by_child = {joint.child: joint for joint in kinematics.joints.values()}
    length, link = 0.0, kinematics.tool
    while link != kinematics.tip and link in by_child:
        length += float(np.linalg.norm(by_child[link].origin[:3, 3]))
        link = by_child[link].parent
    return np.asarray(tip - np.array([0.0, 0.0, max(length, 0.05)]))


def _project(points: Array) -> Array:
    """Positions (n, 3) → (n, 2): the horizontal direction in which the chain extends most, and up."""
    horizontal = points[:, :2] - points[0, :2]
    _, _, directions = np.linalg.svd(horizontal, full_matrices=False)
    along = horizontal @ directions[0]
    return np.column_stack([along * (1.0 if along[np.argmax(np.abs(along))] >= 0 else -1.0), points[:, 2]])


def _fit_to_page(flat: Array) -> Array:
    """Metres → picture coordinates (y downwards), inside the margins of the drawing."""
    low, high = flat.min(axis=0), flat.max(axis=0)
    size = np.maximum(high - low, 1e-6)
    scale = min((DRAWING_WIDTH - 2 * MARGIN) / size[0], (HEIGHT - 2 * MARGIN - 20) / size[1])
    x = MARGIN + 24 + scale * (flat[:, 0] - low[0])
    y = HEIGHT - MARGIN - scale * (flat[:, 1] - low[1])
    return np.column_stack([x, y])


def _ground(base: Array) -> str:
    x, y = base
    ticks = "".join(
        f'<line x1="{x + i:.1f}" y1="{y + 8:.1f}" x2="{x + i - 7:.1f}" y2="{y + 16:.1f}"/>' for i in range(-28, 36, 12)
    )
    plate = f'<rect class="base" x="{x - 30:.1f}" y="{y - 8:.1f}" width="60" height="16" rx="3"/>'
    return f'<g class="ground"><line x1="{x - 44:.1f}" y1="{y + 8:.1f}" x2="{x + 44:.1f}" y2="{y + 8:.1f}"/>{ticks}</g>{plate}'


def _link(a: Array, b: Array, thin: bool) -> str:
    if float(np.hypot(*(b - a))) < 1.0:
        return ""
    return f'<line class="link{" thin" if thin else ""}" {_ends(a, b)}/>'


def _joint_mark(p: Array, prismatic: bool, vertical: bool, hot: bool) -> str:
    x, y = p
    kind = "joint hot" if hot else "joint"
    halo = f'<circle class="halo" cx="{x:.1f}" cy="{y:.1f}" r="19"/>' if hot else ""
    if prismatic:
        return f'{halo}<rect class="{kind}" x="{x - 7:.1f}" y="{y - 7:.1f}" width="14" height="14" rx="2"/>'
    ring = f'<ellipse class="turn" cx="{x:.1f}" cy="{y:.1f}" rx="20" ry="6.5"/>' if vertical else ""
    return f'{halo}{ring}<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="8"/>'


def _name(text: str, p: Array, at: Array) -> str:
    """An axis name beside its joint, on the side away from the middle of the machine."""
    left = p[0] < float(np.median(at[:, 0]))
    x, anchor = (p[0] - 26, "end") if left else (p[0] + 14, "start")
    return f'<text class="axis" x="{x:.1f}" y="{p[1] - 12:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _spread(callouts: Sequence[Callout], place: Mapping[str, Array]) -> list[tuple[Callout, float]]:
    """Call-outs with their heights in the right column: as their places lie, but never on top of each other."""
    known = [callout for callout in callouts if callout.target in place]
    known.sort(key=lambda callout: float(place[callout.target][1]))
    spread = []
    lowest = 40.0
    for number, callout in enumerate(known):
        room_below = sum(other.height for other in known[number:])
        y = min(max(lowest, float(place[callout.target][1])), HEIGHT - room_below + 24)
        lowest = y + callout.height
        spread.append((callout, y))
    return spread


def _leaders(callouts: Sequence[Callout], place: Mapping[str, Array]) -> list[str]:
    """Lines from the places to their call-outs; drawn first, so that the machine lies on top of them."""
    parts = []
    for callout, y in _spread(callouts, place):
        x, height = place[callout.target]
        parts.append(f'<path class="leader" d="M{x + 12:.1f},{height:.1f} L{LABEL_X - 14},{y:.1f} L{LABEL_X - 5},{y:.1f}"/>')
    return parts


def _labels(callouts: Sequence[Callout], place: Mapping[str, Array]) -> list[str]:
    parts = []
    for callout, y in _spread(callouts, place):
        parts += _text(callout, y + 1.0)
    return parts


def _text(callout: Callout, y: float) -> list[str]:
    lines = [("callout", title) for title in callout.titles] + [("detail", callout.detail)]
    return [
        f'<text class="{kind}" x="{LABEL_X}" y="{y + LINE * number:.1f}">{escape(text)}</text>'
        for number, (kind, text) in enumerate(lines)
    ]


def _axis_row(axes: Sequence[Axis], callouts: Sequence[Callout]) -> str:
    """Without geometry: one row an axis, command → cylinder → joint."""
    by_target = {callout.target: callout for callout in callouts}
    parts = []
    y = 34.0
    for axis in axes:
        callout = by_target.get(axis.name)
        stations = ("command", "cylinder", "joint") if axis.drives == "cylinder" else ("command", "joint")
        x = 24.0
        for index, station in enumerate(stations):
            hot = " hot" if callout is not None and index == 1 else ""
            parts.append(f'<rect class="box{hot}" x="{x:.0f}" y="{y - 17:.0f}" width="132" height="34" rx="5"/>')
            parts.append(
                f'<text class="box" x="{x + 66:.0f}" y="{y + 5:.0f}" text-anchor="middle">{escape(axis.name)} {station}</text>'
            )
            if index < len(stations) - 1:
                parts.append(f'<line class="arrow" x1="{x + 133:.0f}" y1="{y:.0f}" x2="{x + 159:.0f}" y2="{y:.0f}"/>')
            x += 160.0
        if callout is not None:
            parts += _text(callout, y - 2.0)
        y += max(54.0, callout.height) if callout is not None else 54.0
    return _svg(parts, "The axes of the machine", round(y))


def _ends(a: Array, b: Array) -> str:
    return f'x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}"'


def _svg(parts: Sequence[str], title: str, height: int) -> str:
    body = "\n".join(part for part in parts if part)
    arrow = '<marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
    defs = f'<defs>{arrow}<path d="M0,0 L8,4 L0,8 z"/></marker></defs>'
    label = f'role="img" aria-label="{escape(title)}"'
    return f'<svg class="machine" viewBox="0 0 {WIDTH} {height}" {label}>{defs}\n{body}\n</svg>'
