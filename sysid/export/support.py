"""The usual order of representations: elements of the format, then the drive model."""

from __future__ import annotations

from collections.abc import Mapping

from sysid.effects import Effect
from sysid.export.drive_data import WITHOUT_PART
from sysid.export.target import Support


def support_of(effect: Effect, native: Mapping[str, str], composed: Mapping[str, str], plugin: str) -> Support:
    """How a target represents an effect.

    Args:
        native, composed: name of an effect → its element or elements.
        plugin: how the drive model represents the others.
    """
    if effect.name in native:
        return Support("native", native[effect.name])
    if effect.name in composed:
        return Support("composed", composed[effect.name])
    if effect.name in WITHOUT_PART:
        return Support("not_representable", WITHOUT_PART[effect.name])
    return Support("plugin", plugin)
