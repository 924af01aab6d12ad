"""The trials: each condition of the decision rule, and each of its constants, changed alone."""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sysid.gap import decision, proof, thresholds
from trials.replaced import load_all

Changes = Mapping[str, Any]


def _never(*_: object, **__: object) -> bool:
    return False


def _always(*_: object, **__: object) -> bool:
    return True


#: Trial → names below `sysid.gap` that are replaced, and by what.
CONDITIONS: Mapping[str, Changes] = {
    "evidence with the discrepancy of each set alone": {"stage_model.StageSearch.own_evidence": lambda _, fit: fit.evidence},
    "a survivor with more effects that is clearly likelier": {"comparison.replaced": _never},
    "survival by predictive density": {"comparison.survives": lambda f, best: f.evidence > best.evidence - decision.LEAST},
    "formulas right: by the noise floor instead": {
        "stage_model.StageSearch.discrepancy_gain": lambda _, fit: 0.0 if fit.left <= thresholds.TENTH else math.inf
    },
    "the simplest model at the noise floor": {"comparison.simplest": lambda model, models: model},
    "each name as large as what remains, beside the others": {"comparison.counts_beside": _always},
    "sizes of values that may be infinite": {"candidates.sizes_of": lambda _, values: (values, np.ones(len(values)))},
    "compensates for a similar effect": {"decision._repairs": _never},
    "at a bound": {"comparison.at_bound": _never},
    "preferred by blocks of the free run": {"free_run.LeastSquares.excess": lambda *_: 0.0},
    "preferred by evidence": {"stage_model.StageSearch.own_evidence": lambda *_: 0.0},
    "the price where the effects act": {"free_run.LeastSquares.left_where_acting": lambda free, f: free.left(f)},
    "the plant: a larger survivor": {"decision._whole": lambda smallest, *_: smallest},
    "the plant: a survivor that leaves less": {"decision._less_left": lambda f, *_: f},
    "open clocks and dead times": {"stage_search._equivalence": lambda *_: {}},
    "servo: certain effects beyond their price": {"decision._beyond_price": lambda _, model, *__: ([], model)},
    "scales shared with a drive": {"stage_search._scales_of_drives": lambda _: set()},
    "scales that their drive contradicts": {"sensor_scales.with_sensor_scales": lambda stages, _: tuple(stages)},
    "weight of unknown masses": {"stage_search._without_masses": lambda case, stage, fitted: fitted},
    "a periodic disturbance instead": {"unnamed.instead.without_periodic_names": lambda stage, _: stage},
    "a function of the position instead": {"unnamed.instead.without_names_of_position": lambda stage, _: stage},
    "sag instead of errors of a sensor": {
        "arm.sag_ties.without_sensor_names": lambda _, stage: stage,
        "arm.sag_ties.sag_tie": lambda *_: None,
    },
    "the names alone on held-out recordings": {"proof._with_proven_model": proof.with_intervals},
    "the price on recordings left out": {"held_out.without_cheap_names": lambda stage: stage},
    "better on held-out recordings": {"held_out.is_better": _always},
    "may be absent by the stated interval": {"stage_intervals.may_be_absent": _never},
    "a share of the gap": {"proof._least_share": lambda _: 0.0},
}
#: By how much a constant is changed.
FACTOR = 1.5


def constants() -> dict[str, Changes]:
    """Every number with a name of its own in `sysid.gap`, larger by half; searches stay as they are."""
    found: dict[str, Changes] = {}
    for module in load_all():
        tree = ast.parse(Path(str(module.__file__)).read_text("utf-8"))
        assigned = [node.targets[0] for node in tree.body if isinstance(node, ast.Assign)]
        targets = [each for target in assigned for each in (target.elts if isinstance(target, ast.Tuple) else [target])]
        below = module.__name__.removeprefix("sysid.gap.")
        for target in targets:
            value = vars(module)[target.id] if isinstance(target, ast.Name) else None
            if isinstance(target, ast.Name) and type(value) in (int, float):
                new = FACTOR * value if isinstance(value, float) else math.ceil(FACTOR * value)
                found[f"{below}.{target.id} x {FACTOR:g}"] = {f"{below}.{target.id}": new}
    return found


TRIALS: Mapping[str, Changes] = {"": {}, **CONDITIONS, **constants()}
