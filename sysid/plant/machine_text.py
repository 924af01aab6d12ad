"""A plant as the text of its ``machine.toml``, and the changes of a repair as a unified diff."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

from sysid.config import parse_settings
from sysid.errors import SettingsError
from sysid.machine import Convention, KnownEffect
from sysid.plant.plant import Plant, effect_key, effects_toml
from sysid.quoting import toml_value

MACHINE_TOML = "machine.toml"

_ANY_TABLE, _RATE = re.compile(r"\s*\["), re.compile(r"\s*rate_hz\s*=")
_TABLE = re.compile(r"\s*\[(?!\[?effects\.)")
_EFFECT = re.compile(r"\s*\[\[\s*effects\s*\]\]")
_PARAMETERS = re.compile(r"\s*parameters\s*=\s*\{[^{}]*\}")


def machine_text(plant: Plant) -> str | None:
    """``machine.toml`` with the effects and the convention of ``plant``; all other lines, comments too, stay as they are.

    Values have six significant digits; unchanged values keep their digits.

    Returns:
        None where the effects in the file are not ``[[effects]]`` tables.
    """
    text = plant.machine.text
    known = {effect_key(item): item for item in plant.machine.effects}
    new_effects = {effect_key(item): item for item in plant.effects}
    lines = _with_convention(text, plant.machine.convention)
    blocks = _blocks(lines)
    if len(blocks) != len(plant.machine.effects):
        return None
    edited, at = list[str](), 0
    for (begin, end), item in zip(blocks, plant.machine.effects, strict=True):
        edited += lines[at:begin]
        at = end
        becomes = new_effects.get(effect_key(item))
        if becomes is None:
            at = _after_blank(lines, end)
        else:
            edited += _changed(lines[begin:end], item, becomes)
        if (begin, end) == blocks[-1]:
            edited += _added([item for key, item in new_effects.items() if key not in known], edited)
    if not blocks:
        edited, at = [*lines, *_added(list(new_effects.values()), lines)], len(lines)
    made = "".join([*edited, *lines[at:]])
    return made if _describes(made, text, plant) else None


def machine_difference(before: Plant, after: Plant) -> str:
    """Difference from ``before`` to ``after`` as input of ``patch machine.toml``; empty without a difference.

    Where the effects in the file are not ``[[effects]]`` tables, the difference of the effects written as such tables.
    """
    texts = machine_text(before), machine_text(after)
    if texts[0] is None or texts[1] is None:
        old, new = (effects_toml(sorted(plant.effects, key=_sort_key)) for plant in (before, after))
    else:
        old, new = texts[0], texts[1]
    parts = difflib.unified_diff(old.splitlines(keepends=True), new.splitlines(keepends=True), MACHINE_TOML, MACHINE_TOML)
    return "".join(part if part.endswith("\n") else f"{part}\n\\ No newline at end of file\n" for part in parts)


def _with_convention(text: str, convention: Convention | None) -> list[str]:
    """The lines of the file with the convention that it does not state yet, behind the rate."""
    lines = text.splitlines(keepends=True)
    if convention is None or tomllib.loads(text).get("convention") == convention:
        return lines
    head = next((k for k, line in enumerate(lines) if _ANY_TABLE.match(line)), len(lines))
    at = next((k + 1 for k, line in enumerate(lines[:head]) if _RATE.match(line)), 0)
    return [*lines[:at], f"convention = {toml_value(convention)}\n", *lines[at:]]


def _blocks(lines: Sequence[str]) -> list[tuple[int, int]]:
    """First and last+1 line of each ``[[effects]]`` table, without the blank lines and comments behind it."""
    heads = [k for k, line in enumerate(lines) if _TABLE.match(line)]
    found = []
    for begin, beyond in zip(heads, [*heads[1:], len(lines)], strict=True):
        if _EFFECT.match(lines[begin]):
            last = max(k for k in range(begin, beyond) if lines[k].strip() and not lines[k].lstrip().startswith("#"))
            found.append((begin, last + 1))
    return found


def _changed(block: Sequence[str], item: KnownEffect, becomes: KnownEffect) -> list[str]:
    """The lines of one table with other values; where the values are in one line, only that line changes."""
    order = [key for key in item.parameters if key in becomes.parameters]
    order += [key for key in becomes.parameters if key not in item.parameters]
    ordered = KnownEffect(becomes.name, becomes.target, {key: becomes.parameters[key] for key in order}, becomes.side)
    rendered, present = effects_toml([ordered]), effects_toml([item])
    if rendered == present:
        return list(block)
    holding = [k for k, line in enumerate(block) if _PARAMETERS.match(line)]
    values = next(line for line in rendered.splitlines() if line.startswith("parameters"))
    if len(holding) != 1:
        return rendered.splitlines(keepends=True)
    k = holding[0]
    return [*block[:k], _PARAMETERS.sub(lambda _: values, block[k], count=1), *block[k + 1 :]]


def _added(new: Sequence[KnownEffect], before: Sequence[str]) -> list[str]:
    """Lines of further tables, a blank line in front of each."""
    if not new:
        return []
    end = "\n" if before and not before[-1].endswith("\n") else ""
    blank = "\n" if before and before[-1].strip() else ""
    return [part for part in (end, blank) if part] + effects_toml(new).splitlines(keepends=True)


def _after_blank(lines: Sequence[str], end: int) -> int:
    return end + 1 if end < len(lines) and not lines[end].strip() else end


def _describes(made: str, text: str, plant: Plant) -> bool:
    """Whether the edited file parses and describes the old machine with the effects and the convention of ``plant``."""
    try:
        new, old = tomllib.loads(made), tomllib.loads(text)
        listed = [parse_settings(entry, KnownEffect, MACHINE_TOML) for entry in new.pop("effects", [])]
    except (tomllib.TOMLDecodeError, SettingsError):
        return False
    for values in (old, new):
        values.pop("effects", None)
    old |= {} if plant.machine.convention is None else {"convention": plant.machine.convention}
    return new == old and _rounded(listed) == _rounded(plant.effects)


def _rounded(effects: Sequence[KnownEffect]) -> Mapping[Any, str]:
    """Values as they are written, by effect and parameter."""
    return {
        (*effect_key(item), name): effects_toml([KnownEffect(item.name, item.target, {name: value}, item.side)])
        for item in effects
        for name, value in item.parameters.items()
    }


def _sort_key(item: KnownEffect) -> tuple[str, str, str]:
    return item.target, item.name, item.side or ""
