"""Remembers what a decision asks of the fits of a case, so that the case is searched once and decided many times.

A search is a value (:class:`sysid.gap.stage_model.StageSearch`), and what the rule asks of it depends on a set of effects and
its values alone. Those results are kept by what they depend on; each decision begins with the sets that the search has fitted.
They can be stored with the case (:mod:`trials.stored`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Any

import numpy as np

from sysid.gap import fit, held_out
from sysid.gap.intervals import known
from sysid.gap.likelihood import stage as likelihood_stage
from sysid.gap.proposals import Proposals
from sysid.gap.stage_model import StageSearch, search_stage
from sysid.gap.unnamed import description, instead
from trials.replaced import replaced


class Memory:
    """The results of one case; ``installed`` puts it in front of the functions that take long."""

    def __init__(self) -> None:
        self._known: dict[Hashable, Any] = {}
        self._numbered: list[object] = []  # likelihoods and problems, which keys contain by their place here

    def installed(self) -> Any:
        """A context in which these functions remember."""
        return replaced(
            {
                "likelihood.stage.fit_model": self._of(
                    likelihood_stage.fit_model, _model_key, lambda likelihood, *_: likelihood
                ),
                "stage_model.search_stage": self._search(search_stage),
                "intervals.known.known_of": self._of(known.known_of, _known_key),
                "held_out.cross_validated_error": self._of(held_out.cross_validated_error, _error_key),
                "held_out._errors": self._of(held_out._errors, _error_key),
                "held_out.held_out_error": self._of(held_out.held_out_error, lambda stage, theta: (stage.label, _bytes(theta))),
                "unnamed.description.describe_residual": self._of(description.describe_residual, _residual_key),
                "unnamed.description.describe_period": self._of(description.describe_period, _residual_key),
                "unnamed.description.worst_residual": self._of(description.worst_residual, _residual_key),
                "unnamed.instead._better": self._of(instead._better, lambda *parts: tuple(map(_series, parts))),
                "fit.fit_candidates": self._of(fit.fit_candidates, _fit_key),
            }
        )

    def _of(
        self, function: Callable[..., Any], key_of: Callable[..., Hashable], identified: Callable[..., object] | None = None
    ) -> Any:
        """The function, which remembers; ``identified``: arguments → what the key has by its identity."""
        name = f"{function.__module__}.{function.__qualname__}"

        @functools.wraps(function)
        def remembered(*args: Any, **named: Any) -> Any:
            number = None if identified is None else self._number(identified(*args))
            key = name, number, key_of(*args, **named)
            if key not in self._known:
                self._known[key] = function(*args, **named)
            return self._known[key]

        return remembered

    def _number(self, part: object) -> int:
        found = next((k for k, each in enumerate(self._numbered) if each is part), len(self._numbered))
        if found == len(self._numbered):
            self._numbered.append(part)
        return found

    def _search(self, function: Callable[..., StageSearch]) -> Callable[..., StageSearch]:
        searched = self._of(function, _search_key, lambda given, *_: given.seen.problem)

        @functools.wraps(function)
        def fresh(*args: Any) -> StageSearch:
            found = searched(*args)
            free = replace(found.free, proposals=_copied(found.free.proposals))
            return replace(found, proposals=_copied(found.proposals), free=free)

        return fresh


def _copied(proposals: Proposals) -> Proposals:
    """With the fits of the search, without those that a decision adds."""
    return replace(proposals, fits=dict(proposals.fits))


def _bytes(values: Any) -> bytes:
    return np.ascontiguousarray(values).tobytes()


def _labels(candidates: Any) -> tuple[str, ...]:
    return tuple(candidate.label for candidate in candidates)


def _names(recordings: Any) -> tuple[str, ...]:
    return tuple(recording.name for recording in recordings)


def _model_key(likelihood: object, candidates: Any, starts: Any, rounds: int = likelihood_stage.ROUNDS, tried: int = 1) -> Any:
    return _labels(candidates), _bytes(starts), rounds, tried


def _search_key(given: Any, timing: float) -> Any:
    return _bytes(given.theta), _bytes(given.seen.sigma), _labels(given.candidates), tuple(given.nameable), timing


def _known_key(data: Any, theta: Any, fitted: Any, noise: Any, seed: int) -> Any:
    return (
        data.problem.stage,
        data.problem.target,
        _bytes(theta),
        _bytes(fitted.theta),
        _labels(fitted.candidates),
    )


def _error_key(stage: Any, model: Any) -> Any:
    return stage.label, _bytes(stage.theta), _bytes(model.theta), _labels(model.candidates), stage.found.accumulates


def _residual_key(problem: Any, theta: Any, recordings: Any, machine: Any) -> Any:
    return problem.stage, problem.target, _bytes(theta), _names(recordings)


def _fit_key(data: Any, theta: Any, candidates: Any, starts: Any, *rest: Any) -> Any:
    here = data.problem.stage, data.problem.target, _names(data.recordings)
    return here, _bytes(theta), _labels(candidates), _bytes(np.array(starts)), rest


def _series(part: Any) -> tuple[bytes, ...]:
    return tuple(_bytes(series.target) for series in part)
