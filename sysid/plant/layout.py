"""The flat parameter vector of a compiled plant: which number stands where.

``theta = [axis 0 | axis 1 | … | base | tool]``; every axis has the same block of slots, neutral values mean "absent".
An effect that may sit on two sides has one set of slots for each.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.effects import CATALOGUE, Effect, effect_named
from sysid.errors import SettingsError, nearest

Array = npt.NDArray[np.float64]
Key = tuple[str, str | None, str]


def _block(target: str) -> dict[Key, tuple[int, float]]:
    """(effect, side, slot) → (place in the block, neutral value)."""
    block: dict[Key, tuple[int, float]] = {}
    for effect in CATALOGUE:
        if effect.target == target:
            for side in effect.sides or (None,):
                for slot in effect.slots:
                    block[effect.name, side, slot.name] = (len(block), slot.neutral)
    return block


_AXIS, _BASE, _TOOL = _block("axis"), _block("base"), _block("tool")
AXIS_WIDTH = len(_AXIS)


def axis_place(effect: str, side: str | None = None) -> int:
    """Place of the effect's first slot inside an axis block (a constant for the compiled chain)."""
    return min(place for (name, at, _), (place, _) in _AXIS.items() if name == effect and at == side)


def base_place(axes: int) -> int:
    return axes * AXIS_WIDTH


def tool_place(axes: int) -> int:
    return axes * AXIS_WIDTH + len(_BASE)


def neutral_vector(axes: int) -> Array:
    """``theta`` of a plant without any effect."""
    axis = [neutral for _, neutral in _AXIS.values()]
    rest = [neutral for _, neutral in (*_BASE.values(), *_TOOL.values())]
    return np.array(axis * axes + rest)


def slot_index(axis_names: Sequence[str], effect: Effect, target: str, side: str | None, slot: str) -> int:
    """Index into ``theta``.

    Raises:
        SettingsError: the target does not exist, or the side does not fit the effect.
    """
    where = f"effect {effect.name}"
    side = side_of(effect, side)
    if effect.target == "axis":
        if target not in axis_names:
            raise SettingsError(where, f"unknown target {target!r}", nearest(target, axis_names))
        return list(axis_names).index(target) * AXIS_WIDTH + _AXIS[effect.name, side, slot][0]
    if target != effect.target:
        raise SettingsError(where, f"target {target!r}", repr(effect.target))
    if effect.target == "base":
        return base_place(len(axis_names)) + _BASE[effect.name, side, slot][0]
    return tool_place(len(axis_names)) + _TOOL[effect.name, side, slot][0]


def side_of(effect: Effect, side: str | None) -> str | None:
    """The side, checked; the first admissible one where none is given."""
    if not effect.sides:
        if side is not None:
            raise SettingsError(f"effect {effect.name}", f"side {side!r}", "no side: this effect has one place only")
        return None
    if side is None:
        return effect.sides[0]
    if side not in effect.sides:
        raise SettingsError(f"effect {effect.name}", f"side {side!r}", nearest(side, effect.sides))
    return side


def parameter_indices(
    axis_names: Sequence[str], effect_name: str, target: str, side: str | None, parameter: str
) -> list[list[int]]:
    """For each component of a public parameter, the places in ``theta`` that take its value."""
    effect = effect_named(effect_name)
    for form in effect.forms:
        for candidate in form.parameters:
            if candidate.name == parameter:
                return [[slot_index(axis_names, effect, target, side, s) for s in group] for group in candidate.components]
    valid = [name for form in effect.forms for name in form.names]
    raise SettingsError(f"effect {effect_name}", f"unknown parameter {parameter!r}", nearest(parameter, valid))
