"""The result of a stage as plain values: numbers, text, lists and dictionaries.

A candidate is written by its label, and read as that of the receiver, who derives the same candidates from the same recordings.
Fits of models are written once, since several lists of a result contain the same fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from sysid.gap.candidates import Candidate, Unknown
from sysid.gap.decision import Decision, NearMiss
from sysid.gap.drift import DriftStrength
from sysid.gap.fit import Fit
from sysid.gap.likelihood.explained import Explained
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.problem import Problem
from sysid.gap.result import ComparedModel, EffectEvidence
from sysid.gap.stage_model import StageFit
from sysid.gap.stage_result import AcceptedEffect, StageResult

Plain = dict[str, Any]

#: What a result consists of, apart from candidates, problems, fits of models, arrays and plain values.
_CLASSES = {
    found.__name__: found
    for found in (
        AcceptedEffect, ComparedModel, Decision, DriftStrength, EffectEvidence, Explained, Fit, NearMiss, StageFit, StageResult,
        Unknown,
    )
}  # fmt: skip


def from_result(result: StageResult) -> Plain:
    """The result without its problem, which the receiver has."""
    models: list[Plain] = []
    known: dict[int, int] = {}

    def fields_of(value: Any) -> Plain:
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}

    def plain(value: Any) -> Any:
        if isinstance(value, ModelFit):
            if id(value) not in known:
                known[id(value)] = len(models)
                models.append(fields_of(value))
            return {"model": known[id(value)]}
        if isinstance(value, Candidate):
            return {"candidate": value.label}
        if isinstance(value, Problem):
            return {"problem": value.stage}
        if isinstance(value, np.ndarray):
            return {"array": value.ravel().tolist(), "shape": list(value.shape)}
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, Mapping):
            return {"map": {key: plain(item) for key, item in value.items()}}
        if isinstance(value, Sequence) and not isinstance(value, str):
            return [plain(item) for item in value]
        if type(value).__name__ in _CLASSES:
            return {"class": type(value).__name__, "fields": fields_of(value)}
        if value is None or isinstance(value, str | int | float | bool):
            return value
        raise TypeError(f"{type(value).__name__} in the result of a stage has no plain form")

    return {"result": plain(result), "models": models}


def to_result(written: Plain, problem: Problem, candidates: Sequence[Candidate]) -> StageResult:
    """The result of a stage with this problem and these candidates."""
    known = {candidate.label: candidate for candidate in candidates}
    models: list[ModelFit] = []

    def value_of(entry: Any) -> Any:
        if isinstance(entry, list):
            return tuple(value_of(item) for item in entry)
        if not isinstance(entry, dict):
            return entry
        if "model" in entry:
            return models[entry["model"]]
        if "candidate" in entry:
            return known[entry["candidate"]]
        if "problem" in entry:
            return problem
        if "array" in entry:
            return np.array(entry["array"], dtype=np.float64).reshape(entry["shape"])
        if "map" in entry:
            return {key: value_of(item) for key, item in entry["map"].items()}
        return _CLASSES[entry["class"]](**fields_from(entry["fields"]))

    def fields_from(entries: Plain) -> Plain:
        return {key: value_of(item) for key, item in entries.items()}

    models += [ModelFit(**fields_from(entry)) for entry in written["models"]]
    found = value_of(written["result"])
    assert isinstance(found, StageResult)
    return found
