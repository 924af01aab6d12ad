"""``sysid init --from FILE``: the files of a machine from its URDF or MJCF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from sysid.errors import InputError, SettingsError
from sysid.foreign import shown

#: ``--kind`` → actuation of every axis, where the description does not state it.
ACTUATIONS: Mapping[str, str] = {"hydraulic": "velocity", "servo": "position", "force": "force"}


@dataclass(frozen=True)
class Drafted:
    """File name → text of the machine's folder, and what the description contains beyond them."""

    files: Mapping[str, str]
    axes: tuple[str, ...]
    notes: tuple[str, ...]


def drafted_files(path: Path, name: str, kind: str | None, tip: str | None, tool: str | None) -> Drafted:
    """``machine.toml``, ``recipe.toml`` and the URDF of the machine that a URDF or MJCF describes.

    Raises:
        InputError: no such file, or neither a URDF nor an MJCF.
        SettingsError: it contains what ``machine.toml`` cannot express, or ``kind`` contradicts it.
    """
    from sysid.config import settings_text
    from sysid.effects.described import check_described
    from sysid.machine.description import machine_from_files
    from sysid.machine.sources.toml_text import machine_text, recipe_text

    if not path.is_file():
        raise InputError(path, "no such file", "a URDF or an MJCF file")
    text = settings_text(path, "a URDF or an MJCF file")
    root = _root(text, path)
    if root == "mujoco":
        from sysid.machine.sources.mjcf import mjcf_draft

        if kind is not None:
            raise SettingsError("sysid init", "--kind with an MJCF", "its actuators, which state what their controls are")
        draft = mjcf_draft(path, tip, tool)
    else:
        from sysid.machine.sources.urdf import urdf_draft

        actuation = None if kind is None else ACTUATIONS[kind]
        draft = urdf_draft(text, path.name, tip, actuation, tool)  # type: ignore[arg-type]
    described = machine_text(draft, name)
    machine = machine_from_files({"machine.toml": described, f"{name}.urdf": draft.urdf}, path.name)
    check_described(machine)
    kinematics = machine.kinematics()
    assert kinematics is not None
    recipe = recipe_text(draft, name, [kinematics.is_prismatic(axis.joint) for axis in draft.axes])
    files = {"machine.toml": described, "recipe.toml": recipe, f"{name}.urdf": draft.urdf}
    return Drafted(files, machine.axis_names, draft.notes)


def _root(text: str, path: Path) -> str:
    """The root element: ``robot`` or ``mujoco``."""
    from defusedxml.common import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        root = str(fromstring(text, forbid_dtd=True).tag)
    except (ParseError, DefusedXmlException, ValueError, LookupError, RecursionError) as error:
        raise InputError(path, f"not readable as XML ({error})", "a URDF or an MJCF file") from None
    if root not in ("robot", "mujoco"):
        remedy = "Convert a xacro with `xacro FILE > robot.urdf`." if "xacro" in root else ""
        raise InputError(path, f"root element {shown(root)}", "<robot> (URDF) or <mujoco> (MJCF)", remedy)
    return root
