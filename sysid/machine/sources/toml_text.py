"""Text of ``machine.toml`` and ``recipe.toml`` for a drafted machine, with comments that explain each key."""

from __future__ import annotations

from collections.abc import Sequence

from sysid.machine.description import KnownEffect, ServoLaw
from sysid.machine.kinematics import GRAVITY
from sysid.machine.sources.draft import AxisDraft, MachineDraft
from sysid.numbers import LARGEST
from sysid.quoting import comment, toml_key, toml_value

_UNITS = {("velocity", True): "1", ("velocity", False): "1", ("force", True): "N", ("force", False): "N·m"}


def machine_text(draft: MachineDraft, name: str) -> str:
    """``machine.toml``; its URDF is ``<name>.urdf``."""
    lines = [
        f"# Drafted from {comment(draft.source)}. SI units (m, rad, s, N, N·m, kg). Check it before use.",
        "# Fields: docs/guide/mujoco.md",
        _row("schema", "1", "version of this file format"),
        _row("name", toml_value(name), "name of the machine and of its dataset"),
        _row("rate_hz", f"{draft.rate_hz:.1f}", "even time grid of the dataset [Hz], assumed: take that of the fastest log"),
        _row("urdf", toml_value(f"{name}.urdf"), "geometry and masses"),
        _row("tip", toml_value(draft.tip), "URDF link whose origin is the end effector"),
    ]
    lines.append(
        _row("tool", toml_value(draft.tool), "URDF link of a hanging tool")
        if draft.tool is not None
        else '# tool = "…"                     # URDF link of a hanging tool, if it is measured'
    )
    if draft.gravity != GRAVITY:
        lines.append(_row("gravity", f"{draft.gravity:.9g}", "of the model [m/s²]; of the Earth 9.80665"))
    if draft.left_out:
        lines += ["left_out = [                     # what the description contains beyond this file"]
        lines += [*(f"    {toml_value(line)}," for line in draft.left_out), "]"]
    for axis in draft.axes:
        lines += ["", *_axis(axis)]
    lines += [
        "",
        "# [noise]                        # standard deviation of a sensor [SI]; else estimated where the machine rests",
    ]
    lines += [f"# {toml_key(f'{draft.axes[0].name}.joint')} = 1e-4"]
    for effect in (effect for axis in draft.axes for effect in axis.effects):
        lines += ["", *_effect(effect)]
    return "\n".join(lines) + "\n"


def recipe_text(draft: MachineDraft, name: str, prismatic: Sequence[bool]) -> str:
    """``recipe.toml`` for tables whose columns have canonical signal names.

    Args:
        prismatic: whether each axis is.
    """
    example = f"{draft.axes[0].name}.command, {draft.axes[0].name}.joint, …"
    lines = [
        f"# Which column is which signal. As it is: logs/<recording>/*.csv with the columns time, {example}",
        _row("schema", "1", "version of this file format"),
        _row("name", toml_value(name), "name of the dataset"),
        _row("machine", toml_value("machine.toml"), "relative to this file; paths never leave this folder"),
        _row("logs", toml_value("logs"), "each folder in it is one recording; files side by side in it are one together"),
        "",
        "# [recordings.files]             # or, where each file in logs is a recording of its own:",
        '# monday = "monday.csv"          # its name = the file, below logs',
        "",
        "[[streams]]                      # one entry per kind of file",
        _row("files", toml_value("*.csv"), "which files of a recording"),
        _row("time", toml_value("time"), "column of the time stamps"),
        _row(
            "domain", toml_value("machine"), 'the clock of these files; files with another name here are aligned to "machine"'
        ),
        "[streams.signals]                # field: the column; unit: of its values; sign = -1 where it counts the other way",
    ]
    for axis, straight in zip(draft.axes, prismatic, strict=True):
        unit = "m" if straight else "rad"
        for quantity, its in (("command", _UNITS.get((axis.actuation, straight), unit)), ("joint", unit)):
            signal = f"{axis.name}.{quantity}"
            lines.append(f"{toml_key(signal)} = {{ field = {toml_value(signal)}, unit = {toml_value(its)} }}")
    return "\n".join(lines) + "\n"


def _axis(axis: AxisDraft) -> list[str]:
    lines = [
        f"[[axes]]                         # {comment(axis.about)}",
        _row("name", toml_value(axis.name), f"its signals are {axis.name}.command and {axis.name}.joint"),
        _row("joint", toml_value(axis.joint), "URDF joint, whose limits are those of the axis"),
        _row("actuation", toml_value(axis.actuation), "position (response of a servo) | servo | velocity | force"),
        _row("drives", toml_value("joint"), "what the command moves"),
    ]
    if axis.actuation == "velocity":
        lines.append(_row("gain", f"{axis.gain:.6g}", "speed at command 1.0 [rad/s or m/s]"))
    if axis.inertia is not None:
        lines.append(_row("inertia", f"{axis.inertia:.6g}", "of the rotor, beside the masses of the URDF [kg·m² or kg]"))
    if axis.servo is not None:
        lines += [
            "# force = clip(kp·(command − q) − kv·q̇); step, friction: how the simulator makes them",
            f"servo = {_servo(axis.servo)}",
        ]
    if axis.limits is not None:
        lines.append(
            _row("limits", f"[{axis.limits[0]:.6g}, {axis.limits[1]:.6g}]", "end stops; the joint states none: set them")
        )
    return lines


def _servo(law: ServoLaw) -> str:
    """The controller of a servo axis as an inline table."""
    values = [f"kp = {law.kp:.6g}", f"kv = {law.kv:.6g}"]
    if isinstance(law.force_limit, tuple):
        low, high = (max(min(end, LARGEST), -LARGEST) for end in law.force_limit)
        values.append(f"force_limit = [{low:.6g}, {high:.6g}]")
    elif law.force_limit is not None:
        values.append(f"force_limit = {law.force_limit:.6g}")
    if law.step > 0.0:
        values += [f"step = {law.step:.6g}", *([] if law.implicit else ["implicit = false"])]
    if law.friction_give > 0.0:
        values += [f"friction_give = {law.friction_give:.6g}", f"friction_time = {law.friction_time:.6g}"]
    return f"{{ {', '.join(values)} }}"


def _effect(effect: KnownEffect) -> list[str]:
    values = ", ".join(f"{key} = {value:.6g}" for key, value in effect.parameters.items() if isinstance(value, float))
    side = [] if effect.side is None else [f"side = {toml_value(effect.side)}"]
    return [
        "[[effects]]",
        f"name = {toml_value(effect.name)}",
        f"target = {toml_value(effect.target)}",
        *side,
        f"parameters = {{ {values} }}",
    ]


def _row(key: str, value: str, about: str) -> str:
    return f"{f'{key} = {value}':<33}# {about}"
