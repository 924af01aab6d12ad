"""Evaluates one answer against the truth: names and targets, parameters, intervals, closed gap."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from hidden.cases import CaseSpec

Name = tuple[str, str]
#: From this multiple of the detection limit on, an effect is to be named.
DUE = 3.0
#: A signal counts as closable where it was above this multiple of its noise floor.
CLOSABLE = 1.5
#: Parameters that are known to fewer digits than others: their error has a bound of its own.
COARSE = (("gripper_sway", "damping_ratio"), ("stiction", "release"))
#: A name describes a hidden effect where its best fit explains this share of it.
DESCRIBED = 0.5


@dataclass(frozen=True)
class CaseResult:
    """One case.

    Args:
        hidden, named: (effect, target). ``aliases``: other names of what was named.
        factor: of the least visible hidden effect, in detection limits.
        errors: relative error by ``effect(target).parameter``, of what was rightly named.
        covered: whether the 95 % interval holds the truth, by the same keys.
        alike: keys whose truth is a number of the machine, in a formula that bench and plant share; elsewhere the truth is
            itself a fit, that of the plant's formula to what the machine did without noise.
        closed: least share of the closable gap that was closed over all signals; None where nothing was named or closable.
        unnamed: whether structure was described that has no name.
        explained: share of what is hidden that the best fit of its own names takes away, noise-free; 1 where they are exact.
        refused: near misses, (effect, target, the condition for a name that it fails).
        failure: why there is no answer.
    """

    spec: CaseSpec
    hidden: tuple[Name, ...]
    named: tuple[Name, ...]
    factor: float
    verdict: str
    wrong: tuple[Name, ...]
    missed: tuple[Name, ...]
    errors: dict[str, float]
    covered: dict[str, bool]
    closed: float | None
    unnamed: bool
    seconds: float
    explained: float = 1.0
    alike: tuple[str, ...] = ()
    refused: tuple[tuple[str, str, str], ...] = ()
    failure: str | None = None

    @property
    def exact(self) -> bool:
        return self.failure is None and not self.wrong and not self.missed

    @property
    def due(self) -> bool:
        """Whether every hidden effect is far enough above its detection limit to be named."""
        return self.factor >= DUE * 0.99

    def to_json(self) -> dict[str, Any]:
        """Infinity and NaN (no hidden effect, no answer) become None."""
        values = {**asdict(self), "spec": self.spec.to_json(), "exact": self.exact, "due": self.due}
        return {key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in values.items()}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> CaseResult:
        """What :meth:`to_json` wrote."""
        given = {each.name: values[each.name] for each in fields(cls) if each.name in values}  # older files know fewer
        given |= {key: tuple((name, target) for name, target in given[key]) for key in ("hidden", "named", "wrong", "missed")}
        given["alike"] = tuple(given["alike"])
        given["refused"] = tuple((name, target, lacks) for name, target, lacks in given.get("refused", ()))
        given["factor"] = math.inf if given["factor"] is None else given["factor"]
        given["seconds"] = math.nan if given["seconds"] is None else given["seconds"]
        return cls(**(given | {"spec": CaseSpec.from_json(given["spec"])}))


def evaluate(sealed: Mapping[str, Any], answered: Mapping[str, Any], reach: Mapping[str, float] | None = None) -> CaseResult:
    """Compare an answer with the truth.

    Args:
        reach: what the true plant scores by signal; without it the noise floor stands for it.
    """
    spec = CaseSpec.from_json(sealed["spec"])
    hidden = tuple((e["name"], e["target"]) for each in sealed["hidden"] for e in each["effects"])
    factor = min((each["factor"] for each in sealed["hidden"]), default=math.inf)
    if "failure" in answered:
        return CaseResult(
            spec, hidden, (), factor, "failure", (), hidden, {}, {}, None, False, math.nan, failure=answered["failure"]
        )
    answer = answered["answer"]
    effects = answer["effects"]
    right = {(e["name"], e["target"]): e for e in effects if meant(e, hidden) is not None}
    named = tuple((e["name"], e["target"]) for e in effects)
    truths = {(e["name"], e["target"]): e for e in sealed["effects"]}
    evaluated = {(e["name"], e["target"]) for each in sealed["hidden"] if each["judged"] for e in each["effects"]}
    compared = {
        name: _compare(name, e, truths[name]["parameters"]) for name, e in right.items() if name in evaluated & truths.keys()
    }
    found = {meant(e, hidden) for e in effects}
    return CaseResult(
        spec=spec,
        hidden=hidden,
        named=named,
        factor=factor,
        verdict=answer["verdict"],
        wrong=tuple(name for name in named if name not in right),
        missed=tuple(name for name in hidden if name not in found),
        errors={key: error for each in compared.values() for key, (error, _) in each.items()},
        covered={key: holds for each in compared.values() for key, (_, holds) in each.items()},
        closed=_closed(answer["gap"], reach or {}) if right else None,
        unnamed=bool(answer["unnamed"]),
        seconds=answered["seconds"],
        explained=_explained(sealed.get("model_error", {})),
        alike=tuple(key for name, each in compared.items() if truths[name].get("exact") for key in each),
        refused=tuple((miss["name"], miss["target"], miss["lacks"]) for miss in answer.get("near_misses", ())),
    )


def meant(effect: Mapping[str, Any], hidden: tuple[Name, ...]) -> Name | None:
    """The hidden effect that a named one is, under its own name or an exact alias."""
    names = [(effect["name"], effect["target"]), *((a["name"], a["target"]) for a in effect.get("aliases", ()))]
    return next((name for name in names if name in hidden), None)


def _compare(name: Name, effect: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, tuple[float, bool]]:
    """Relative error, and whether the interval holds the truth, by ``effect(target).parameter``.

    Of vectors the largest component sets the scale; an interval covers if it does so in all components.
    """
    compared = {}
    for key, value in truth.items():
        if key not in effect["parameters"]:
            continue
        found, true = np.atleast_1d(effect["parameters"][key]), np.atleast_1d(value)
        scale = float(np.max(np.abs(true)))
        if scale == 0.0 or found.shape != true.shape:
            continue
        low, high = (np.atleast_1d(side) for side in effect["interval95"][key])
        error, holds = float(np.max(np.abs(found - true)) / scale), bool(np.all((low <= true) & (true <= high)))
        compared[f"{name[0]}({name[1]}).{key}"] = error, holds
    return compared


def _closed(gap: Mapping[str, Mapping[str, float]], reach: Mapping[str, float]) -> float | None:
    """Flow disturbance and model error remain with the true plant as well: they are not closable."""
    least = {signal: max(floor, reach.get(signal, 0.0)) for signal, floor in gap["noise_floor"].items()}
    shares = [
        (before - gap["after"][signal]) / (before - least[signal])
        for signal, before in gap["before"].items()
        if before > CLOSABLE * least[signal]
    ]
    return min(shares, default=None)


def _explained(error: Mapping[str, Mapping[str, float]]) -> float:
    """Least share, over the affected signals, of the hidden effects that the best fit of their names explains.

    Squares are compared: RMSE of noise-free runs with nothing hidden, before and after the best fit of the names.
    """
    shares = [1.0]
    for signal, before in error.get("before", {}).items():
        without, after = error["nothing_hidden"][signal], error["after"][signal]
        if before > CLOSABLE * without:
            shares.append(1.0 - max(after**2 - without**2, 0.0) / (before**2 - without**2))
    return min(shares)
