"""Differences of two model versions: recipe, dataset, figures, files, geometry, predictions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.datasets.versions.diff import NameChanges, ValueChange
from sysid.errors import StoreError
from sysid.files import plain
from sysid.networks import Calibration, Model, StructuredForward, from_files
from sysid.registry import NETWORKS, ModelVersion
from sysid.registry.effect_changes import EffectChange, effect_changes
from sysid.versions.outputs import OutputMap, output_maps, points_between, sweep_between

Array = npt.NDArray[np.float64]
#: Entries of a lineage that are compared by themselves.
_APART = ("recipe", "effects")


@dataclass(frozen=True)
class GeometryChange:
    """One parameter of a calibrated geometry; NaN for a version without it.

    Args:
        before, after: deviation from the URDF, in ``unit``.
        sigmas: their difference in combined standard deviations.
    """

    parameter: str
    unit: str
    before: float
    after: float
    sigmas: float


@dataclass(frozen=True)
class PredictionChange:
    """Difference of two versions' predictions of one output over their common range.

    Args:
        largest, rms: of the difference, in ``unit``; NaN if the ranges do not overlap, or the time steps differ.
        at: input signal → its value [SI] at the largest difference.
        points: number of compared points.
    """

    output: str
    unit: str
    largest: float
    rms: float
    at: Mapping[str, float]
    points: int


@dataclass(frozen=True)
class ModelDiff:
    """Differences between version ``before`` and version ``after``; all empty if there are none.

    Args:
        same_content: both have the same digest.
        recipe: keys of the recipe.
        lineage: the rest of the lineage, the dataset first.
        effects: of plants.
        figures: stored metrics.
        files: by name; changed: another sha256.
        geometry: parameters of calibrated forward models.
        predictions: of networks of the same signals.
        outputs: predicted by only one of them.
    """

    before: str
    after: str
    kind: str
    same_content: bool
    recipe: tuple[ValueChange, ...]
    lineage: tuple[ValueChange, ...]
    effects: tuple[EffectChange, ...]
    figures: tuple[ValueChange, ...]
    files: NameChanges
    geometry: tuple[GeometryChange, ...]
    predictions: tuple[PredictionChange, ...]
    outputs: NameChanges

    @property
    def empty(self) -> bool:
        """Whether nothing differs."""
        found = (self.recipe, self.lineage, self.effects, self.figures, self.files, self.geometry, self.outputs)
        return not any(map(bool, found)) and not any(entry.largest > 0.0 for entry in self.predictions)

    def to_json(self) -> dict[str, Any]:
        """Plain values, schema 1."""
        result: dict[str, Any] = plain({"schema": 1, **asdict(self)})
        return result


def diff_versions(before: ModelVersion, after: ModelVersion) -> ModelDiff:
    """Compare two versions.

    Args:
        before, after: with their files, from ``Registry.load``.

    Raises:
        StoreError: different kinds, or a damaged file.
    """
    if before.kind != after.kind:
        raise StoreError(f"model {after.reference}", f"is of kind {after.kind!r}", f"{before.kind!r}, as {before.reference}")
    recipes = [dict(version.lineage.get("recipe") or {}) for version in (before, after)]
    others = [{key: value for key, value in version.lineage.items() if key not in _APART} for version in (before, after)]
    models = [from_files(v.files, v.reference) for v in (before, after)] if before.kind in NETWORKS else []
    maps = [{answer.key: answer for answer in output_maps(model)} for model in models] or [{}, {}]
    return ModelDiff(
        before=before.reference,
        after=after.reference,
        kind=before.kind,
        same_content=before.digest == after.digest,
        recipe=_changes(*recipes),
        lineage=tuple(sorted(_changes(*others), key=lambda change: not change.what.startswith("dataset"))),
        effects=effect_changes(before.lineage, after.lineage),
        figures=_changes(dict(before.metrics), dict(after.metrics)),
        files=_names(before.sha256, after.sha256),
        geometry=_geometry(*models) if models else (),
        predictions=tuple(_predicted(maps[0][key], maps[1][key]) for key in maps[0] if key in maps[1]),
        outputs=NameChanges(*(tuple(f"{k[0]} from {', '.join(k[1])}" for k in a if k not in b) for a, b in (maps[::-1], maps))),
    )


def _changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[ValueChange, ...]:
    """Differing values of nested tables."""
    left, right = dict(_flat(before)), dict(_flat(after))
    keys = dict.fromkeys([*left, *right])
    return tuple(ValueChange(key, left.get(key), right.get(key)) for key in keys if left.get(key) != right.get(key))


def _flat(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping) and (value or not path):
        for key, item in value.items():
            yield from _flat(item, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value):
        for number, item in enumerate(value):
            yield from _flat(item, f"{path}[{number}]")
    else:
        yield path, list(value) if isinstance(value, tuple) else value


def _names(before: Mapping[str, str], after: Mapping[str, str]) -> NameChanges:
    added, removed = (tuple(sorted(set(a) - set(b))) for a, b in ((after, before), (before, after)))
    return NameChanges(added, removed, tuple(sorted(name for name in before if name in after and before[name] != after[name])))


def _geometry(before: Model, after: Model) -> tuple[GeometryChange, ...]:
    found = []
    for model in (before, after):
        structure = model.structure if isinstance(model, StructuredForward) else None
        parameters = structure.parameters if isinstance(structure, Calibration) else ()
        found.append({p.parameter.key: (p.parameter.unit, p.value, p.deviation) for p in parameters})
    changes = []
    for key in dict.fromkeys([*found[0], *found[1]]):
        unit = (found[0].get(key) or found[1][key])[0]
        a, b = (side.get(key, (unit, math.nan, math.nan)) for side in found)
        if a[1] != b[1]:
            sigma = math.hypot(a[2], b[2])
            changes.append(GeometryChange(key, unit, a[1], b[1], abs(b[1] - a[1]) / sigma if sigma > 0.0 else math.nan))
    return tuple(changes)


def _predicted(before: OutputMap, after: OutputMap) -> PredictionChange:
    low, high = np.maximum(before.low, after.low), np.minimum(before.high, after.high)
    if np.any(low > high) or before.rate_hz != after.rate_hz:
        return PredictionChange(before.output, before.unit, math.nan, math.nan, {}, 0)
    points = sweep_between(low, high) if before.run is not None else points_between(low, high)
    difference = after.predict(points) - before.predict(points)
    worst = int(np.argmax(np.abs(difference)))
    return PredictionChange(
        output=before.output,
        unit=before.unit,
        largest=float(np.abs(difference[worst])),
        rms=float(np.sqrt(np.mean(difference**2))),
        at=dict(zip(before.inputs, points[worst].tolist(), strict=True)) if difference[worst] else {},
        points=len(points),
    )
