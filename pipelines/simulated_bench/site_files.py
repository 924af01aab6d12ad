"""What a site hands over beside its logs: ``machine.toml``, the URDF of the drawing, and the recipe that maps the logs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from simulated_bench.capture_recipe import BodySettings, marker_label
from simulated_bench.recipe import AXES, WIRED, AxisSettings, BenchRecipe
from simulated_bench.write import LOG_FILES, write_database

Array = npt.NDArray[np.float64]


def machine_toml(recipe: BenchRecipe, gains: dict[str, float], effects: Sequence[dict[str, Any]]) -> str:
    """The description of the drawn machine with the ``gains`` and ``effects`` that its owner has measured."""
    lines = ["schema = 1", f'name = "{recipe.name}"', f"rate_hz = {recipe.controller.rate}", f'urdf = "{recipe.name}.urdf"']
    lines += ['tip = "tip"', 'tool = "gripper"']
    for name in AXES:
        axis = recipe.axis(name)
        drives = "cylinder" if axis.cylinder is not None else "joint"
        lines += [
            "",
            "[[axes]]",
            f'name = "{name}"',
            f'joint = "{name}_joint"',
            'actuation = "velocity"',
            f'drives = "{drives}"',
        ]
        lines += [f"gain = {gains[name]:.6g}"]
        if axis.cylinder is not None:
            lines += [f"stroke = [0.0, {axis.cylinder.stroke}]", f"linkage = {_linkage(axis)}"]
    if recipe.draw_wire.noise > 0.0:
        lines += ["", "[noise]", *(f'"{s}" = {recipe.draw_wire.noise}' for s in map(recipe.drive_signal, WIRED))]
    for effect in effects:
        parameters = ", ".join(f"{key} = {value:.6g}" for key, value in effect["parameters"].items())
        lines += ["", "[[effects]]", f'name = "{effect["name"]}"', f'target = "{effect["target"]}"']
        lines += [f"parameters = {{ {parameters} }}"]
    return "\n".join(lines) + "\n"


def _linkage(axis: AxisSettings) -> str:
    c = axis.cylinder
    assert c is not None
    sizes = f"a = {c.a}, b = {c.b}, offset = {c.offset}, retracted = {c.retracted}, sense = {c.sense}"
    return f'{{ kind = "triangle", {sizes} }}'


def urdf(recipe: BenchRecipe) -> str:
    """The crane as drawn, with its masses."""
    m, g = recipe.masses, recipe.geometry
    limits = {name: recipe.axis(name).limits for name in AXES}
    hang = f'<origin xyz="0 0 {-recipe.gripper.length}"/>'
    parts = [
        f'<?xml version="1.0"?>\n<robot name="{recipe.name}">',
        _link("base", 20.0, 0.0, 0.3),
        _joint("slew", "revolute", "base", "column", "0 0 0", "0 0 1", limits["slew"]),
        _link("column", 6.0, 0.0, m.column_inertia),
        _joint("boom", "revolute", "column", "boom", f"0 0 {g.height}", "0 -1 0", limits["boom"]),
        _link("boom", m.boom, m.boom_centre, m.boom_inertia),
        _joint("stick", "revolute", "boom", "stick", f"{g.boom} 0 0", "0 -1 0", limits["stick"]),
        _link("stick", m.stick, m.stick_centre, m.stick_inertia),
        _joint("telescope", "prismatic", "stick", "tip", f"{g.stick} 0 0", "1 0 0", limits["telescope"]),
        _link("tip", m.telescope, m.telescope_centre, m.telescope_inertia),
        _passive("pitch", "tip", "hook", "0 1 0"),
        _link("hook", 0.001, 0.0, 1e-6),
        _passive("roll", "hook", "hanger", "1 0 0"),
        _link("hanger", 0.001, 0.0, 1e-6),
        f'  <joint name="gripper_mount" type="fixed">\n    <parent link="hanger"/><child link="gripper"/>{hang}\n  </joint>',
        _link("gripper", m.gripper, 0.0, 0.005),
        "</robot>",
    ]
    return "\n".join(parts) + "\n"


def _link(name: str, mass: float, centre: float, inertia: float) -> str:
    moments = f'ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"'
    body = f'<inertial><origin xyz="{centre} 0 0"/><mass value="{mass}"/><inertia {moments}/></inertial>'
    return f'  <link name="{name}">{body}</link>'


def _passive(name: str, parent: str, child: str, axis: str) -> str:
    frame = f'<parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
    return f'  <joint name="gripper_{name}_joint" type="continuous">{frame}</joint>'


def _joint(name: str, kind: str, parent: str, child: str, at: str, axis: str, limits: tuple[float, float]) -> str:
    ends = f'<limit lower="{limits[0]}" upper="{limits[1]}" velocity="1" effort="500"/>'
    frame = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/><axis xyz="{axis}"/>'
    return f'  <joint name="{name}_joint" type="{kind}">\n    {frame}\n    {ends}\n  </joint>'


def recipe_toml(recipe: BenchRecipe, parked: Array) -> str:
    """The mapping of the logs to signals; ``parked`` (4,) are the joint values surveyed while the machine stood parked."""
    motion = [each.name for each in recipe.recordings if not each.is_calibration]
    poses = [each.name for each in recipe.recordings if each.is_calibration]
    capture = recipe.capture
    joints = ", ".join(f"{name} = {value:.6f}" for name, value in zip(AXES, parked, strict=True))
    lines = ["schema = 1", f'name = "{recipe.name}"', 'machine = "machine.toml"', 'logs = "logs"', "", "[recordings]"]
    lines += [f"motion = {_texts(motion)}", f"poses = {_texts(poses)}", "", "[splits]", f"held_out = {_texts(motion[-1:])}", ""]
    lines += _machine_lines(recipe)
    bodies = [f'{body.name} = "{body.link}"' for body in capture.bodies if body.link != "gripper"]
    if not bodies:
        return "\n".join(lines) + "\n"
    export = capture.export[0]
    lines += ["", "[[streams]]", f'files = "{LOG_FILES[export]}"', f'reader = "{export}"', 'domain = "mocap"']
    lines += ['interpolation = "cubic"']
    lines += ['secondary = ["telescope.joint"]', "[streams.frame]", f"translation = {list(capture.translation)}"]
    lines += [f"rpy = {list(capture.rpy)}", "[streams.bodies]", *bodies]
    if export == "c3d":
        lines += ["[streams.marker_sets]", *map(_marker_set, capture.bodies)]
    lines += ["[streams.points]"]
    for point, link in (("ee", "tip"), ("tool", "gripper")):
        for body in (body for body in capture.bodies if body.link == link):
            at = f", at = {pivot_in_set(body).round(7).tolist()}" if export == "c3d" else ""
            lines += [f'{point} = {{ body = "{body.name}"{at} }}']
    lines += ["[streams.reference]", f'recording = "{motion[0]}"', "seconds = [0.2, 1.2]", f"joints = {{ {joints} }}"]
    return "\n".join(lines) + "\n"


def _machine_lines(recipe: BenchRecipe) -> list[str]:
    """The machine's log: messages with their fields, or frames with the signals of the database."""
    kind = recipe.controller.log[0]
    lines = ["[[streams]]", f'files = "{LOG_FILES[kind]}"']
    if kind == "mcap":
        lines += ['reader = "mcap"', 'clock = "header"', 'domain = "machine"', "[streams.signals]"]
        topics, fields = ("/valves/command", "/draw_wires", "/slew_sensor"), ("command[{}]", "position[{}]")
    else:
        lines += ['reader = "can"', f'dbc = "{recipe.name}.dbc"', 'domain = "machine"', "[streams.signals]"]
        topics, fields = ("VALVE_COMMAND", "DRAW_WIRES", "SLEW_SENSOR"), ("{}", "{}")
    for name in AXES:
        lines += [f'"{name}.command" = {{ topic = "{topics[0]}", field = "{fields[0].format(name)}" }}']
    for name in WIRED:
        lines += [
            f'"{recipe.drive_signal(name)}" = {{ topic = "{topics[1]}", field = "{fields[1].format(name)}", unit = "m" }}'
        ]
    slew = f'topic = "{topics[2]}", field = "{fields[1].format("slew")}", unit = "rad", primary = false'
    return [*lines, f'"slew.joint" = {{ {slew} }}']


def _marker_set(body: BodySettings) -> str:
    return f"{body.name} = {_texts([marker_label(body.name, i) for i in range(len(body.markers))])}"


def pivot_in_set(body: BodySettings) -> Array:
    """Where the body's origin was surveyed in the frame that its markers span, (3,) [m].

    That frame has its origin in the centre of the markers, x from the first to the second, z normal to the first three.
    """
    markers = np.array(body.markers)
    centre = markers.mean(axis=0)
    x = markers[1] - markers[0]
    z = np.cross(x, markers[2] - markers[0])
    axes = np.stack([x, np.cross(z, x), z])
    pivot = centre if body.pivot is None else np.array(body.pivot)
    return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True) @ (pivot - centre))


def _texts(names: Sequence[str]) -> str:
    return "[" + ", ".join(f'"{name}"' for name in names) + "]"


def write_site_files(
    folder: Path, recipe: BenchRecipe, gains: dict[str, float], effects: Sequence[dict[str, Any]], parked: Array
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "machine.toml").write_text(machine_toml(recipe, gains, effects), "utf-8")
    (folder / f"{recipe.name}.urdf").write_text(urdf(recipe), "utf-8")
    (folder / "recipe.toml").write_text(recipe_toml(recipe, parked), "utf-8")
    write_database(recipe, folder)
