"""Differences between the named effects of two plants."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from sysid.figures import ParameterFigure


@dataclass(frozen=True)
class EffectChange:
    """One parameter of one effect that differs.

    Args:
        effect, target: its name and where it acts.
        parameter: its name; empty for an effect without parameters.
        before, after: value [SI]; None for a plant without the effect.
        interval95: of the value after, or before where there is none; empty if unknown.
        unit: SI unit; empty where the lineage does not state it.
    """

    effect: str
    target: str
    parameter: str
    before: float | str | None
    after: float | str | None
    interval95: tuple[float, ...] = ()
    unit: str = ""


def effect_changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[EffectChange, ...]:
    """The differing parameters of the effects that two lineages list, in the order of the later one."""
    left, right = dict(_parameters(before)), dict(_parameters(after))
    found = []
    for key in dict.fromkeys([*right, *left]):
        earlier, later = (side[key][0] if key in side else None for side in (left, right))
        if earlier != later or (key in left) != (key in right):
            effect, target, parameter = key
            _, ends, unit = right.get(key) or left[key]
            found.append(EffectChange(effect, target, parameter, earlier, later, ends, unit))
    return tuple(found)


def _parameters(lineage: Mapping[str, Any]) -> Iterator[tuple[tuple[str, str, str], tuple[Any, tuple[float, ...], str]]]:
    for effect in lineage.get("effects", ()):
        place = str(effect.get("name")), str(effect.get("target"))
        parameters, intervals = effect.get("parameters", {}), effect.get("interval95", {})
        for name, value in (parameters or {"": ""}).items():
            ends = intervals.get(name) or ()
            known = all(isinstance(end, float | int) for end in ends)
            yield (*place, name), (value, tuple(ends) if known else (), str(effect.get("units", {}).get(name, "")))


CHANGES = ("effect", "on", "parameter", "before", "after", "95 % interval")


def change_cells(change: EffectChange, title: Callable[[str], str] = str) -> tuple[str, ...]:
    """A row below :data:`CHANGES`; ``title``: of an effect, from its name."""
    ends = (change.interval95[0], change.interval95[1]) if len(change.interval95) == 2 else None
    figure = ParameterFigure(change.parameter, change.unit, change.after, ends, change.before)
    interval = "" if ends is None else figure.interval
    return title(change.effect), change.target, figure.label, figure.before_text, figure.text, interval
