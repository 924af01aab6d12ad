"""Everything that a repair writes into the plant, and the effects that were nearly named."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, TypeVar

import numpy as np

from sysid.datasets.recording import Dataset
from sysid.effects import effect_named
from sysid.effects.described import side_of
from sysid.effects.units import parameter_unit
from sysid.gap.prepare.case import Stage
from sysid.gap.reasons import Reason
from sysid.gap.result import AxisDelay, NamedEffect, NearMissResult, WrittenEffect
from sysid.gap.thresholds import Z
from sysid.machine import EffectKey, KnownEffect
from sysid.plant import Plant
from sysid.plant.plant import effect_key

Entry = TypeVar("Entry", NamedEffect, WrittenEffect, NearMissResult)
DEAD_TIME, LAG = ("input_delay", "delay"), ("first_order_lag", "time_constant")
SECOND_ORDER = "second_order_lag"
_ORDER = ("named", "tied", "adjusted")


def written_effects(
    before: Plant,
    after: Plant,
    named: Sequence[NamedEffect],
    ties: Sequence[Sequence[tuple[str, str]]],
    misses: Sequence[NearMissResult],
    refused: Mapping[EffectKey, Reason],
) -> tuple[WrittenEffect, ...]:
    """The effects in which ``after`` differs from ``before``: named, representing a tie, adjusted without a name."""
    known = {effect_key(item): item for item in before.effects}
    names = {_key(effect.name, effect.target, effect.side): effect for effect in named}
    why = {_key(miss.name, miss.target, miss.side): miss.lacks for miss in misses} | dict(refused)
    tied = {tie[0] for tie in ties}
    found = []
    for item in after.effects:
        key = effect_key(item)
        earlier = dict(known[key].parameters) if key in known else None
        if earlier != dict(item.parameters):
            found.append(_written(item, earlier or {}, names.get(key), tied, why.get(key, ""), after))
    return tuple(sorted(found, key=lambda item: _ORDER.index(item.kind)))


def axis_delays(before: Plant, after: Plant) -> tuple[AxisDelay, ...]:
    """Dead time and lag of every axis that has one, before or after."""
    found = []
    for axis in after.machine.axis_names:
        dead = _value(before, *DEAD_TIME, axis), _value(after, *DEAD_TIME, axis)
        lag = _lag(before, axis), _lag(after, axis)
        if any((*dead, *lag)):
            found.append(AxisDelay(axis, dead, lag))
    return tuple(found)


def _lag(plant: Plant, axis: str) -> float:
    """Delay of the lags of an axis at low frequencies [s]; 2ζT of a second-order one."""
    second = (_value(plant, SECOND_ORDER, name, axis) for name in ("damping_ratio", "time_constant"))
    return _value(plant, *LAG, axis) + 2.0 * math.prod(second)


def _value(plant: Plant, name: str, parameter: str, axis: str) -> float:
    known = plant.effect(name, axis, None)
    value = known.parameters[parameter] if known is not None else 0.0
    return float(value) if isinstance(value, (int, float)) else 0.0


def with_units(entries: Sequence[Entry], dataset: Dataset) -> Iterator[Entry]:
    """The entries with the SI unit of each of their parameters."""
    for item in entries:
        units = {
            key: parameter_unit(item.name, key.partition("[")[0], item.target, dataset.machine, dataset.units)
            for key in item.parameters
        }
        yield replace(item, units=units)


def near_misses(stage: Stage) -> tuple[NearMissResult, ...]:
    """The near misses of a stage, in the order of its decision."""
    fitted = stage.found.stage_fit
    found = []
    for miss in fitted.decision.near_misses if fitted is not None else ():
        name, target, side = miss.candidate.key
        unknowns = miss.candidate.unknowns
        half = Z * miss.deviations
        values = {u.key: float(value) for u, value in zip(unknowns, miss.values, strict=True)}
        ends = zip(map(float, miss.values - half), map(float, miss.values + half), strict=True)
        interval95 = {u.key: pair for u, pair in zip(unknowns, ends, strict=True)}
        size = np.minimum(np.abs(miss.values - np.array([u.nominal for u in unknowns])), np.abs(miss.values))
        away = size / np.maximum(miss.deviations, 1e-12)
        distance = float(np.max(np.nan_to_num(away, nan=0.0, posinf=0.0)))
        found.append(NearMissResult(name, target, stage.label, values, interval95, distance, miss.lacks, side))
    return tuple(found)


def _written(
    item: KnownEffect, earlier: dict[str, Any], name: NamedEffect | None, tied: set[tuple[str, str]], why: str, plant: Plant
) -> WrittenEffect:
    if name is not None:
        ends = {key: name.interval95[key] for key in name.given}
        return WrittenEffect(item.name, item.target, "named", name.given, earlier, ends, name.gap_share, side=item.side)
    kind: Literal["tied", "adjusted"] = "tied" if (item.name, item.target) in tied else "adjusted"
    values, ends = dict(item.parameters), _intervals(item, plant)
    reason = why if kind == "adjusted" else ""
    return WrittenEffect(item.name, item.target, kind, values, earlier, ends, why=reason, side=item.side)


def _intervals(item: KnownEffect, plant: Plant) -> dict[str, tuple[Any, Any]]:
    """95 % intervals of a normal distribution, within the bounds of the parameters."""
    bounds = {p.name: p.bounds for form in effect_named(item.name).forms for p in form.parameters}
    deviations = np.sqrt(np.diag(plant.uncertainty.covariance))
    found: dict[str, list[tuple[float, float]]] = {}
    for place, deviation in zip(plant.uncertainty.places, deviations, strict=True):
        if place.key == effect_key(item) and np.isfinite(deviation):
            given = item.parameters[place.parameter]
            value = float(given if isinstance(given, (int, float)) else given[place.component])
            low, high = bounds[place.parameter]
            ends = float(np.clip(value - Z * deviation, low, high)), float(np.clip(value + Z * deviation, low, high))
            found.setdefault(place.parameter, []).append(ends)
    single = {key: isinstance(item.parameters[key], (int, float)) for key in found}
    return {
        key: ends[0] if single[key] else (tuple(a for a, _ in ends), tuple(b for _, b in ends)) for key, ends in found.items()
    }


def _key(name: str, target: str, side: str | None) -> EffectKey:
    return name, target, side_of(effect_named(name), side)
