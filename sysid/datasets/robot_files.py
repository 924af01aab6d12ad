"""``sysid init --from FILE``: the files of a machine from its URDF or MJCF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.errors import InputError, SettingsError
from sysid.foreign import shown
from sysid.parse import read_xml

if TYPE_CHECKING:
    from sysid.machine import Machine
    from sysid.machine.sources.draft import MachineDraft


@dataclass(frozen=True)
class Choices:
    """What the user chooses in a description.

    Args:
        kind: how joints are commanded that do not state it: servo, hydraulic or force; or response: servos by their responses.
        base: link or body that is held still.
        tip, tool: end effector, and what hangs on it.
        assets: folders beside that of an MJCF whose files may be opened.
    """

    kind: str | None = None
    base: str | None = None
    tip: str | None = None
    tool: str | None = None
    assets: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Drafted:
    """File name → text of the machine's folder; what the description contains beyond them, and what it does not state."""

    files: Mapping[str, str]
    axes: tuple[str, ...]
    tip: str
    left_out: tuple[str, ...]
    assumed: tuple[str, ...]


def drafted_apart(path: Path, name: str, choices: Choices) -> Drafted:
    """:func:`drafted_files` in a process of its own, which a hostile description cannot leave.

    Raises:
        InputError, SettingsError: as of :func:`drafted_files`; it takes more than ``DESCRIPTION_LIMITS``.
    """
    from sysid.confined import confined
    from sysid.machine.sources.mjcf_model import DESCRIPTION_LIMITS

    return confined(lambda report: drafted_files(path, name, choices), path, DESCRIPTION_LIMITS, (Drafted,))


def drafted_files(path: Path, name: str, choices: Choices) -> Drafted:
    """``machine.toml``, ``recipe.toml`` and the URDF of the machine that a URDF or MJCF describes.

    Raises:
        InputError: no such file, or neither a URDF nor an MJCF.
        SettingsError: it contains what ``machine.toml`` cannot express.
    """
    from sysid.machine.sources.draft import RESPONSE, recipe_text

    if not path.is_file():
        raise InputError(path, "no such file", "a URDF or an MJCF file")
    try:
        text = read_xml(path)
    except ValueError as error:
        raise InputError(path, str(error), "a URDF or an MJCF file", "Save it as UTF-8.") from None
    if _root(text, path) == "mujoco":
        from sysid.machine.sources.mjcf import mjcf_draft

        draft = mjcf_draft(path, choices.tip, choices.tool, choices.kind, choices.base, choices.assets)
    else:
        from sysid.machine.sources.urdf import urdf_draft

        kind = "servo" if choices.kind == RESPONSE else choices.kind  # a URDF states no controllers
        draft = urdf_draft(text, path.name, choices.tip, kind, choices.tool, choices.base)
    draft, described, machine = _within_bounds(draft, name)
    kinematics = machine.kinematics()
    assert kinematics is not None
    recipe = recipe_text(draft, name, [kinematics.is_prismatic(axis.joint) for axis in draft.axes])
    files = {"machine.toml": described, "recipe.toml": recipe, f"{name}.urdf": draft.urdf}
    return Drafted(files, machine.axis_names, draft.tip, draft.left_out, draft.assumed)


def _within_bounds(draft: MachineDraft, name: str) -> tuple[MachineDraft, str, Machine]:
    """The draft without effects whose values are outside of the catalogue's range, its text, and the machine of it."""
    from sysid.effects.described import check_described, check_known_effect
    from sysid.machine.description import machine_from_files
    from sysid.machine.sources.draft import machine_text

    def machine_of(draft: MachineDraft) -> tuple[str, Machine]:
        described = machine_text(draft, name)
        return described, machine_from_files({"machine.toml": described, f"{name}.urdf": draft.urdf}, draft.source)

    described, machine = machine_of(draft)
    axes, beyond = [], list[str]()
    for axis in draft.axes:
        kept = []
        for effect in axis.effects:
            try:
                check_known_effect(machine, effect, None)
                kept.append(effect)
            except SettingsError as error:
                beyond.append(f"{effect.name} of {axis.name}: {error.found}, where the effect has {error.expected}")
        axes.append(replace(axis, effects=tuple(kept)))
    if beyond:
        draft = replace(draft, axes=tuple(axes), left_out=(*draft.left_out, *beyond))
        described, machine = machine_of(draft)
    check_described(machine)
    return draft, described, machine


def _root(text: str, path: Path) -> str:
    """The root element: ``robot`` or ``mujoco``."""
    from sysid.machine.urdf_tree import xml_root

    try:
        root = str(xml_root(text).tag)
    except ValueError as error:
        raise InputError(path, f"not readable as XML ({error})", "a URDF or an MJCF file") from None
    if root not in ("robot", "mujoco"):
        remedy = "Convert a xacro with `xacro FILE > robot.urdf`." if "xacro" in root else ""
        raise InputError(path, f"root element {shown(root)}", "<robot> (URDF) or <mujoco> (MJCF)", remedy)
    return root
