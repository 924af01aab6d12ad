"""One row of the comparison, computed."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from agreement.fitting import Unknown, baseline, fit, rmse
from agreement.machines import description, recipe_of, record
from agreement.rows import Row


@dataclass(frozen=True)
class Agreement:
    """Result of one row; errors are RMSE on a recording that no fit has used [unit].

    Args:
        alone: of the baseline on the machine without the feature.
        without, with_effect: on the machine with the feature, before and after the effect is added to the plant.
        parameters: as fitted; ``own``: setting of the machine. ``base``: settings of the machine in both runs.
    """

    effect: str
    target: str
    side: str | None
    machine: str
    base: dict[str, Any]
    feature: dict[str, Any]
    signals: tuple[str, ...]
    unit: str
    alone: float
    without: float
    with_effect: float
    parameters: dict[str, float | list[float]]
    own: dict[str, float | tuple[float, ...]]
    seconds: float

    @property
    def share(self) -> float:
        """What is left of the error once the effect is in."""
        return self.with_effect / self.without


def agreement(row: Row) -> Agreement:
    begin = time.perf_counter()
    fixed = tuple(row.base.items())
    plain, real = recipe_of(row.machine_name, dict(fixed)), recipe_of(row.machine_name, {**row.base, **row.feature})
    axes = description(plain).axis_names
    moved = tuple(axis for axis in axes if row.target == axis or row.target not in axes)
    if row.signals[0].split(".")[0] in ("ee", "tool"):
        moved = axes
    before = baseline(row.machine_name, fixed, moved, row.also)
    fitting = [record(real, program, 201 + k, row.seconds) for k, program in enumerate(row.programs)]
    unseen = record(real, row.unseen, 301, row.seconds)
    after = fit(before, [Unknown(row.effect, row.target, row.guess, row.side)], fitting, row.signals)
    found = after.effect(row.effect, row.target, row.side)
    assert found is not None
    first = row.signals[0]
    return Agreement(
        effect=row.effect,
        target=row.target,
        side=row.side,
        machine=row.machine_name,
        base=dict(row.base),
        feature=dict(row.feature),
        signals=row.signals,
        unit=before.machine.expected_unit(first) or "m",
        alone=rmse(before, [record(plain, row.unseen, 301, row.seconds)], row.signals),
        without=rmse(before, [unseen], row.signals),
        with_effect=rmse(after, [unseen], row.signals),
        parameters=dict(found.parameters),
        own=dict(row.own),
        seconds=time.perf_counter() - begin,
    )
