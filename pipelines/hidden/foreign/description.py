"""The owner's description of a machine: ``machine.toml`` with the known effects, and a URDF as drawn."""

from __future__ import annotations

from collections.abc import Sequence

from hidden.foreign.machines import CRANE_AXES, FORCE_AXIS, Tables, axes_of, noise_of
from hidden.foreign.mjcf import MASSES
from sysid.machine import KnownEffect, Machine, machine_from_files


def machine_of(tables: Tables, gains: dict[str, float], known: Sequence[KnownEffect]) -> Machine:
    """The description as `sysid` reads it."""
    return machine_from_files(files_of(tables, gains, known), tables["family"])


def files_of(
    tables: Tables, gains: dict[str, float], known: Sequence[KnownEffect], noise: float | None = None
) -> dict[str, str]:
    """File name → text.

    Args:
        gains: of the velocity axes, speed at command 1 [rad/s or m/s].
        noise: multiple of the usual noise, from the data sheets; without it the description does not say it.
    """
    name = tables["family"].replace("mujoco_", "").replace("bullet_", "")
    posed = tables["family"] not in FORCE_AXIS
    lines = ["schema = 1", f'name = "{name}"', f"rate_hz = {tables['rate']}"]
    if posed:
        lines += [f'urdf = "{name}.urdf"', 'tip = "tip"']
    if tables["family"] == "mujoco_crane":
        lines.append('tool = "gripper"')
    for axis in axes_of(tables):
        lines += ["", "[[axes]]", f'name = "{axis}"', 'drives = "joint"']
        if not posed:
            low, high = tables["limits"]
            lines += ['actuation = "force"', f"inertia = {tables['inertia']}", f"limits = [{low:.9g}, {high:.9g}]"]
            continue
        velocity = tables["family"] == "mujoco_crane"
        lines += [f'joint = "{axis}_joint"', f'actuation = "{"velocity" if velocity else "position"}"']
        lines.append(f"gain = {gains[axis]:.12g}" if velocity else "gain = 1.0")
    if noise is not None:
        said = {signal: value for signal, value in noise_of(tables, noise).items() if not signal.endswith(".command")}
        lines += ["", "[noise]", *(f'"{signal}" = {value:.6g}' for signal, value in said.items())]
    for effect in known:
        values = ", ".join(f"{key} = {value}" for key, value in effect.parameters.items())
        lines += ["", "[[effects]]", f'name = "{effect.name}"', f'target = "{effect.target}"', f"parameters = {{ {values} }}"]
    found = {"machine.toml": "\n".join(lines) + "\n"}
    if posed:
        found[f"{name}.urdf"] = _crane_urdf(tables) if tables["family"] == "mujoco_crane" else arm_urdf(tables)
    return found


def _crane_urdf(tables: Tables) -> str:
    links = tables["links"]
    places = {
        "slew": (0.0, 0.0, 0.0),
        "boom": (0.0, 0.0, links["height"]),
        "stick": (links["boom"], 0.0, 0.0),
        "telescope": (links["stick"], 0.0, 0.0),
    }
    lengths = {"boom": links["boom"], "stick": links["stick"], "telescope": -0.2}
    parts = ['<?xml version="1.0"?>\n<robot name="crane">\n  <link name="base"/>']
    parent = "base"
    for name in CRANE_AXES:
        link = "tip" if name == "telescope" else f"{name}_link"
        about = {"slew": (0, 0, 1), "telescope": (1, 0, 0)}.get(name, (0, -1, 0))
        kind = "prismatic" if name == "telescope" else "revolute"
        centre = (0.0, 0.0, 0.1) if name == "slew" else (0.5 * lengths[name], 0.0, 0.0)
        parts.append(_joint(name, kind, parent, link, places[name], about, tables["axes"][name]["limits"]))
        parts.append(_link(link, MASSES[name], centre, abs(lengths.get(name, 0.2))))
        parent = link
    parts.append(
        '  <joint name="gripper_joint" type="fixed"><parent link="tip"/><child link="gripper"/></joint>\n'
        f"{_link('gripper', MASSES['tool'], (0.0, 0.0, 0.0), 0.01)}\n</robot>"
    )
    return "\n".join(parts) + "\n"


def arm_urdf(tables: Tables) -> str:
    parts = ['<?xml version="1.0"?>\n<robot name="arm">\n' + _link("base", 1.0, (0.0, 0.0, 0.0), 0.1)]
    parent, at = "base", 0.0
    for name, axis in tables["axes"].items():
        parts.append(_joint(name, "revolute", parent, f"{name}_link", (at, 0.0, 0.0), (0, -1, 0), axis["limits"]))
        parts.append(_link(f"{name}_link", axis["mass"], (0.5 * axis["length"], 0.0, 0.0), axis["length"]))
        parent, at = f"{name}_link", axis["length"]
    parts.append(
        f'  <joint name="tip_joint" type="fixed"><parent link="{parent}"/><child link="tip"/><origin xyz="{at} 0 0"/></joint>\n'
        f"{_link('tip', 1e-6, (0.0, 0.0, 0.0), 0.01)}\n</robot>"
    )
    return "\n".join(parts) + "\n"


def _joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    place: tuple[float, ...],
    about: tuple[int, ...],
    limits: Sequence[float],
) -> str:
    x, y, z = place
    a, b, c = about
    return (
        f'  <joint name="{name}_joint" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{x:.9g} {y:.9g} {z:.9g}"/><axis xyz="{a} {b} {c}"/>'
        f'<limit lower="{limits[0]:.9g}" upper="{limits[1]:.9g}" velocity="10" effort="1000"/></joint>'
    )


def _link(name: str, mass: float, centre: tuple[float, ...], length: float) -> str:
    x, y, z = centre
    thin = mass * length**2 / 12.0
    return (
        f'  <link name="{name}"><inertial><origin xyz="{x:.9g} {y:.9g} {z:.9g}"/><mass value="{mass}"/>'
        f'<inertia ixx="{thin:.6g}" ixy="0" ixz="0" iyy="{thin:.6g}" iyz="0" izz="{thin:.6g}"/></inertial></link>'
    )
