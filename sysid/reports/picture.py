"""Drawing of the machine (inline SVG): links, cylinders, valves, tool, with numbered marks at the location of effects (valve,
cylinder, joint, link, sensor, tool …).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from sysid.effects import BY_NAME
from sysid.gap.result import GapResult, StageGap
from sysid.machine import Axis, Kinematics, Machine
from sysid.machine.kinematics import Joint
from sysid.reports import words
from sysid.reports.picture_parts import (
    PARTS_HEIGHT,
    Canvas,
    badge,
    base,
    cylinder,
    drive,
    joint,
    link,
    name,
    pipe,
    pump,
    tool,
    valve,
)
from sysid.signals import split_signal

Array = npt.NDArray[np.float64]

#: Stage → part at its end, for unnamed errors.
_OF_STAGE = {
    "command": "valve",
    "force": "cylinder",
    "joint": "joint",
    "end_effector": "link",
    "tool": "tool",
    "free_run": "sensor",
}


@dataclass(frozen=True)
class Mark:
    """A numbered place on the drawing.

    Args:
        number: shown in the mark and beside the text about it.
        part: ``valve``, ``cylinder``, ``joint``, ``link``, ``sensor``, ``tool``, ``base``, ``pump`` or ``clock``.
        target: axis, signal or stream that the part belongs to.
        sure: False for open hypotheses, which are drawn hollow.
    """

    number: int
    part: str
    target: str
    sure: bool = True


def part_of(effect: str, target: str, machine: Machine, parameters: Collection[str] = ()) -> str:
    """The part of the machine that has an effect; without hydraulics a drive instead of valve and cylinder.

    Args:
        parameters: names of its parameters, since forms of an effect may have different places.
    """
    part: str = BY_NAME[effect].part_of(frozenset(parameters)) if effect in BY_NAME else "valve"
    if part in ("valve", "cylinder") and target in machine.axis_names:
        axis = machine.axis(target)
        if not has_valve(axis, machine) or (part == "cylinder" and axis.drives == "joint"):
            return "drive"
    return part


def has_valve(axis: Axis, machine: Machine) -> bool:
    """Whether the command of an axis moves a hydraulic valve."""
    return axis.actuation == "velocity" and machine.drive_of(axis.name) == "hydraulic"


def place_text(part: str, target: str) -> str:
    """``valve of the boom``; parts that exist once have no owner."""
    if part == "sensor":
        return f"sensor {words.signal_name(target)}"
    if part == "clock":
        return f"clock of {target}"
    if part in ("tool", "base", "pump"):
        return part
    if part == "link" and target == "ee":
        return "links up to the tip"
    return f"{part} of the {words.owner_name(target)}"


def marks_of(gap: GapResult, machine: Machine) -> tuple[Mark, ...]:
    """Marks of the effects, then of ambiguous sets (one number per set), then of unnamed errors."""
    marks = [Mark(k, part_of(e.name, e.target, machine, e.parameters), e.target) for k, e in enumerate(gap.effects, 1)]
    number = len(marks)
    for tie in gap.ambiguous:
        number += 1
        places = dict.fromkeys((part_of(name, target, machine), target) for name, target in tie)
        marks += [Mark(number, part, target, sure=False) for part, target in places]
    for item in gap.unnamed:
        number += 1
        marks.append(Mark(number, _of_stage(item.stage, item.target, machine), item.target, sure=False))
    return tuple(marks)


def stage_marks(found: Sequence[StageGap], machine: Machine) -> tuple[Mark, ...]:
    """A hollow mark for each stage with an error, in their order."""
    return tuple(Mark(k, _of_stage(i.stage, i.target, machine), i.target, sure=False) for k, i in enumerate(found, 1))


def _of_stage(stage: str, target: str, machine: Machine) -> str:
    part = _OF_STAGE.get(stage, "valve")
    if part in ("valve", "cylinder") and target in machine.axis_names and not has_valve(machine.axis(target), machine):
        return "drive"
    return part


def axis_of(mark: Mark, names: Sequence[str]) -> str | None:
    """The axis that a mark belongs to; of ``boom.joint`` it is the boom."""
    owner = mark.target if mark.target in names else split_signal(mark.target)[0]
    return owner if owner in names else None


#: Width, greatest height and margin of the drawing [px].
WIDTH, HEIGHT, MARGIN = 560, 470, 48
#: Radius of a numbered mark and width of a letter [px].
BADGE, LETTER = 12.0, 7.4

#: (part, axis) → its position on the page.
Places = dict[tuple[str, str], Array]


def machine_picture(machine: Machine, marks: Sequence[Mark] = ()) -> Markup:
    """Side view of the machine with numbered marks; without a URDF a row of parts for each axis."""
    kinematics = machine.kinematics()
    if kinematics is None or not kinematics.chain:
        return _axis_rows(machine, marks)
    return _side_view(machine, kinematics, marks)


# -- with geometry -------------------------------------------------------------------------------------------------------


def _side_view(machine: Machine, kinematics: Kinematics, marks: Sequence[Mark]) -> Markup:
    poses = {link: pose[0] for link, pose in kinematics.link_poses(_middle(machine, kinematics)).items()}
    chain = kinematics.chain
    points = [poses[chain[0].parent][:3, 3], *(poses[j.child][:3, 3] for j in chain)]
    # Start of a telescope at its link, where the thick line ends.
    sleeves = [(poses[j.parent] @ j.origin)[:3, 3] for j in chain]
    hanging = _tool_point(kinematics, points[-1])
    every, height = _fit_to_page(_project(np.array([*points, *sleeves, *([] if hanging is None else [hanging])])))
    at, sleeve_at = every[: len(points)], every[len(points) : len(points) + len(sleeves)]
    places: Places = {("base", ""): at[0], ("link", "ee"): at[-1], ("sensor", "ee"): at[-1]}
    hot = {(mark.part, axis_of(mark, machine.axis_names) or "") for mark in marks}
    canvas = Canvas(WIDTH, height)
    below, above = [base(at[0], ("base", "") in hot)], list[str]()
    canvas.box(at[0] + np.array([0.0, 26.0]), (46.0, 34.0))  # the ground
    for k in range(len(chain)):
        below += [link(at[k], sleeve_at[k], thin=False), link(sleeve_at[k], at[k + 1], thin=True)]
        canvas.line(at[k], sleeve_at[k], 6.5)
        canvas.line(sleeve_at[k], at[k + 1], 3.5)
    if hanging is not None:
        below.append(tool(at[-1], every[-1], ("tool", "") in hot))
        places["tool", ""] = places["sensor", "tool"] = every[-1]
        canvas.line(at[-1], every[-1])
        canvas.box(every[-1], (9.0, 9.0))
    for axis in machine.axes:
        index = next(i for i, j in enumerate(chain) if j.name == axis.joint)
        drawn = _axis_parts(axis, chain[index], index, at, sleeve_at, poses, hot, canvas)
        below += drawn[0]
        above += drawn[1]
        places |= drawn[2]
    above.append(f'<circle class="tip" cx="{at[-1][0]:.1f}" cy="{at[-1][1]:.1f}" r="4"/>')
    above += _valves(machine, hot, places, canvas)
    if any(mark.part in ("pump", "clock") for mark in marks):
        above += _off_machine(marks, places, canvas)
    badges = _badges(marks, machine, places, canvas)
    names = []
    for axis in machine.axes:
        half = (0.5 * LETTER * len(axis.name), 8.0)
        names.append(name(axis.name, canvas.place(places["joint", axis.name], half, (11.0, 16.0, 22.0, 32.0, 44.0))))
    return _svg([*below, *above, *names, *badges], f"Side view of {machine.name}", round(height))


def _axis_parts(
    axis: Axis,
    about: Joint,
    index: int,
    at: Array,
    sleeve_at: Array,
    poses: Mapping[str, Array],
    hot: set[tuple[str, str]],
    canvas: Canvas,
) -> tuple[list[str], list[str], Places]:
    """(drawn below, drawn above, places) of the cylinder and the joint of an axis."""
    pivot, child = sleeve_at[index], at[index + 1]
    onward = next((p for p in at[index + 2 :] if float(np.hypot(*(p - child))) > 1.0), child)
    place = 0.5 * (pivot + child) if about.prismatic else child
    vertical = not about.prismatic and abs((poses[about.child][:3, :3] @ about.axis)[2]) > 0.9
    places: Places = {
        ("joint", axis.name): place,
        ("sensor", axis.name): place,
        ("link", axis.name): 0.5 * (child + onward),
        ("drive", axis.name): place,
        ("cylinder", axis.name): place,
    }
    below = []
    if axis.drives == "cylinder":
        behind = next((p for p in at[index::-1] if float(np.hypot(*(p - child))) > 1.0), child)
        rear, front = _cylinder_ends(child, behind, onward)
        below.append(cylinder(rear, front, ("cylinder", axis.name) in hot or ("drive", axis.name) in hot))
        canvas.line(rear, rear + 0.58 * (front - rear), 7.0)
        canvas.line(rear, front, 2.0)
        places["drive", axis.name] = places["cylinder", axis.name] = rear + 0.35 * (front - rear)
    canvas.box(place, (20.0, 8.0) if vertical else (8.0, 8.0))
    return below, [joint(place, about.prismatic, vertical, ("joint", axis.name) in hot)], places


def _valves(machine: Machine, hot: set[tuple[str, str]], places: Places, canvas: Canvas) -> list[str]:
    """A valve or motor beside the actuator of each axis, with a pipe between them."""
    parts = []
    for axis in machine.axes:
        actuator = places["cylinder", axis.name]
        spot = canvas.place(actuator, (22.5, 9.0) if has_valve(axis, machine) else (11.0, 11.0), (16.0, 22.0, 30.0, 42.0))
        symbol = (
            valve(spot, ("valve", axis.name) in hot) if has_valve(axis, machine) else drive(spot, ("drive", axis.name) in hot)
        )
        parts.append(pipe(actuator, spot) + symbol)
        places["valve", axis.name] = spot
        if not has_valve(axis, machine):
            places["drive", axis.name] = spot
    return parts


def _cylinder_ends(pivot: Array, behind: Array, onward: Array) -> tuple[Array, Array]:
    """Attachments of a cylinder on the links before and after its joint, so that the triangle is visible."""
    back, forth = behind - pivot, onward - pivot
    long_back, long_forth = float(np.hypot(*back)), float(np.hypot(*forth))
    reach = max(46.0, 0.5 * min(max(long_back, 90.0), long_forth))
    rear = pivot + back * (min(reach * 1.15, 0.85 * long_back) / max(long_back, 1e-9))
    front = pivot + forth * (min(reach, 0.75 * long_forth) / max(long_forth, 1e-9))
    along = front - rear
    bend = abs(float(along[0] * (pivot - rear)[1] - along[1] * (pivot - rear)[0])) / max(float(np.hypot(*along)), 1e-9)
    if bend < 22.0:  # nearly straight: shifted beside the links
        lift = _aside(along, np.array([0.0, -1.0])) * (22.0 - bend)
        rear, front = rear + lift, front + lift
    return rear, front


def _aside(along: Array, towards: Array) -> Array:
    """Unit vector across ``along`` on the side of ``towards``."""
    across = np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-9)
    return across if float(across @ towards) >= 0.0 else -across


def _badges(marks: Sequence[Mark], machine: Machine, places: Mapping[tuple[str, str], Array], canvas: Canvas) -> list[str]:
    """Numbers beside their parts."""
    drawn = []
    for mark in marks:
        owner = axis_of(mark, machine.axis_names) or ""
        if mark.part in ("sensor", "link") and not owner:
            owner = mark.target if mark.part == "link" else split_signal(mark.target)[0]
        part = places.get((mark.part, owner), places.get((mark.part, ""), places["base", ""]))
        if mark.part == "sensor" and split_signal(mark.target)[1] == "cylinder":
            part = places.get(("cylinder", owner), part)
        drawn.append(
            badge(part, canvas.place(part, (BADGE, BADGE), (8.0, 14.0, 22.0, 32.0, 44.0)), mark.number, mark.sure, BADGE)
        )
    return drawn


def _off_machine(marks: Sequence[Mark], places: Places, canvas: Canvas) -> list[str]:
    """Pump and clocks, in the corner."""
    parts, x = [], WIDTH - 60.0
    for part in dict.fromkeys(mark.part for mark in marks if mark.part in ("pump", "clock")):
        spot = np.array([x, 34.0])
        places[part, ""] = spot
        canvas.box(spot + np.array([0.0, 10.0]), (20.0, 32.0))
        parts.append(pump(spot, part))
        x -= 100.0
    return parts


def _middle(machine: Machine, kinematics: Kinematics) -> Array:
    """Every axis in the middle of its range; an unlimited one at zero. Shape (1, n_axes)."""
    values = []
    for axis in machine.axes:
        low, high = axis.limits or kinematics.limits(axis.joint or "")
        values.append(0.5 * (low + high) if math.isfinite(low + high) else 0.0)
    return np.array([values])


def _tool_point(kinematics: Kinematics, tip: Array) -> Array | None:
    """Position of the tool: below the tip by the length of the joints between them."""
    if kinematics.tool is None or kinematics.tool == kinematics.tip:
        return None
    by_child = {j.child: j for j in kinematics.joints.values()}
    length, at = 0.0, kinematics.tool
    while at != kinematics.tip and at in by_child:
        length += float(np.linalg.norm(by_child[at].origin[:3, 3]))
        at = by_child[at].parent
    return np.asarray(tip - np.array([0.0, 0.0, max(length, 0.05)]))


def _project(points: Array) -> Array:
    """Positions (n, 3) → (n, 2): the horizontal direction in which the chain extends most, and up."""
    horizontal = points[:, :2] - points[0, :2]
    _, _, directions = np.linalg.svd(horizontal, full_matrices=False)
    along = horizontal @ directions[0]
    return np.column_stack([along * (1.0 if along[np.argmax(np.abs(along))] >= 0 else -1.0), points[:, 2]])


def _fit_to_page(flat: Array) -> tuple[Array, float]:
    """Metres → picture coordinates (y downwards), inside the margins, and the height of the picture."""
    low, high = flat.min(axis=0), flat.max(axis=0)
    size = np.maximum(high - low, 1e-6)
    scale = min((WIDTH - 2 * MARGIN - 40) / size[0], (HEIGHT - 2 * MARGIN) / size[1])
    height = max(200.0, scale * size[1] + 2 * MARGIN)
    x = 0.5 * (WIDTH + 30 - scale * size[0]) + scale * (flat[:, 0] - low[0])
    y = height - MARGIN - scale * (flat[:, 1] - low[1])
    return np.column_stack([x, y]), float(height)


# -- without geometry ----------------------------------------------------------------------------------------------------


def _axis_rows(machine: Machine, marks: Sequence[Mark]) -> Markup:
    """One row per axis, in the order of the signal chain: valve → cylinder → joint."""
    names = machine.axis_names
    parts, y = [], 36.0
    for axis in machine.axes:
        boxes = ["valve" if has_valve(axis, machine) else "drive"]
        boxes = [*boxes, *(["cylinder"] if axis.drives == "cylinder" else []), "joint"]
        parts.append(name(axis.name, np.array([60.0, y])))
        x = 118.0
        for k, box in enumerate(boxes):
            here = [m for m in marks if axis_of(m, names) == axis.name and _box_of(m, boxes) == box]
            look = f"box{' hot' if here else ''}"
            parts.append(f'<rect class="{look}" x="{x:.0f}" y="{y - 17:.0f}" width="112" height="34" rx="5"/>')
            parts.append(f'<text class="box" x="{x + 56:.0f}" y="{y + 5:.0f}" text-anchor="middle">{escape(box)}</text>')
            if k < len(boxes) - 1:
                parts.append(f'<line class="arrow" x1="{x + 113:.0f}" y1="{y:.0f}" x2="{x + 139:.0f}" y2="{y:.0f}"/>')
            for n, mark in enumerate(here):
                spot = np.array([x + 104.0 - 26.0 * n, y - 18.0])
                parts.append(badge(spot, spot, mark.number, mark.sure, BADGE))
            x += 140.0
        y += PARTS_HEIGHT
    others = [m for m in marks if axis_of(m, names) is None]
    for n, mark in enumerate(others):
        parts.append(name(mark.part, np.array([60.0, y])))
        parts.append(badge(np.array([130.0, y]), np.array([130.0, y]), mark.number, mark.sure, BADGE))
        y += 0.6 * PARTS_HEIGHT if n < len(others) - 1 else 0.0
    return _svg(parts, "The axes of the machine", round(y + (20.0 if others else -12.0)))


def _box_of(mark: Mark, boxes: Sequence[str]) -> str:
    """The box of a mark; for a sensor that of its signal."""
    if mark.part in boxes:
        return mark.part
    if mark.part == "sensor" and split_signal(mark.target)[1] == "cylinder":
        return "cylinder" if "cylinder" in boxes else boxes[0]
    return "joint" if mark.part in ("joint", "link", "sensor") else boxes[0]


def _svg(parts: Sequence[str], title: str, height: int) -> Markup:
    body = "\n".join(part for part in parts if part)
    arrow = '<marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
    defs = f'<defs>{arrow}<path d="M0,0 L8,4 L0,8 z"/></marker></defs>'
    label = f'role="img" aria-label="{escape(title)}"'
    return Markup(f'<svg class="machine" viewBox="0 0 {WIDTH} {height}" {label}>{defs}\n{body}\n</svg>')
