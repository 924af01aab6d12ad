"""Which effects are missing at one stage: forward, exchange, backward, then every rival once more.

Forward selection is liberal (prediction of unseen recordings), since evidence on drifting residuals stops too early; what
stays is judged strictly (whitened evidence *and* block bootstrap *and* a size worth a name). Smaller models are refitted
from the larger one's optimum as well as from nominal, so that nothing is kept only because the smaller fit had not converged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.drift import log_density
from sysid.gap.evidence import Comparison, confidence_set, gain_p_value
from sysid.gap.fit import Data, Fit, fit_candidates, jacobian, spread_of
from sysid.gap.problem import Problem, Split

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Strictness:
    """Thresholds of the search.

    Args:
        gap: a stage whose error is below this multiple of its noise floor is explained.
        forward: least gain in log predictive density on unseen recordings that adds an effect for the time being.
        ratio, delta_bic, p_value: what an effect needs to stay; ``ratio`` is of free-run RMSE on unseen recordings.
        sensitivity: least share of an effect's influence that no other fitted parameter can imitate.
        most: largest number of effects at one stage.
    """

    gap: float = 1.15
    forward: float = 3.0
    ratio: float = 1.0
    delta_bic: float = 10.0
    p_value: float = 0.01
    sensitivity: float = 0.02
    most: int = 6


@dataclass(frozen=True)
class Trial:
    """One fitted set of effects and how it did, for the evidence table."""

    effects: tuple[str, ...]
    parameters: dict[str, float]
    fit_rmse: float
    selection_rmse: float
    delta_bic: float
    verdict: str


@dataclass(frozen=True)
class Kept:
    """An effect that stays: its part of the fit, why it was kept, and the rivals that lost or tied."""

    candidate: Candidate
    comparison: Comparison
    rejected: tuple[tuple[Candidate, str], ...] = ()
    ties: tuple[Candidate, ...] = ()


@dataclass(frozen=True)
class Finding:
    """The outcome at one stage.

    Args:
        named: effects that a name is given to.
        adjusted: nuisance parameters that moved by less than is worth a name, but matter.
        fit: the final fit, on all recordings that may be seen.
        nominal_rmse, final_rmse: of unseen recordings, as multiples of the noise floor.
    """

    problem: Problem
    named: tuple[Kept, ...]
    adjusted: tuple[Candidate, ...]
    fit: Fit
    nominal_rmse: float
    final_rmse: float
    trials: tuple[Trial, ...] = ()


@dataclass
class Search:
    """State of the search at one stage: a cache of fits and the table of trials."""

    problem: Problem
    theta: Array
    split: Split
    sigma: Array
    candidates: Sequence[Candidate]
    nuisances: Sequence[Candidate]
    strict: Strictness = field(default_factory=Strictness)
    seed: int = 0
    on_fit: Callable[[str], None] = lambda text: None
    _fits: dict[frozenset[str], Fit] = field(default_factory=dict)
    _scores: dict[frozenset[str], tuple[Array, float]] = field(default_factory=dict)
    _trials: list[Trial] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.fitting = Data(self.problem, self.split.fit, self.sigma)
        self.selecting = Data(self.problem, self.split.select, self.sigma)

    def run(self) -> Finding:
        """Name what is missing, or nothing."""
        nominal = self._fit((), ())
        nominal_rmse = self._rmse(nominal)
        if nominal_rmse <= self.strict.gap:
            return Finding(self.problem, (), (), nominal, nominal_rmse, nominal_rmse)
        model = self._forward()
        model = self._exchange(model)
        model, _ = self._backward(model, keep_nuisances=True)
        rivals = {c.key: self._rivals(model, c) for c in self._ordinary(model)}  # while nuisances are free: they imitate much
        model, kept = self._backward(model)
        ordinary = [c for c in model.candidates if not c.nuisance or _departs(c, model)]
        named = tuple(Kept(c, kept[c.label], *rivals.get(c.key, ((), ()))) for c in ordinary)
        adjusted = tuple(c for c in model.candidates if c not in ordinary)
        seen = Data(self.problem, self.split.seen, self.sigma)
        final = fit_candidates(seen, self.theta, model.candidates, [model.values])
        return Finding(self.problem, named, adjusted, final, nominal_rmse, self._rmse(final), tuple(self._trials))

    # -- steps ---------------------------------------------------------------------------------------------------

    def _forward(self) -> Fit:
        model = self._fit(tuple(self.nuisances), ())
        while len(self._ordinary(model)) < self.strict.most and self._rmse(model) > self.strict.gap:
            trials = [self._fit(_joined(model.candidates, c), (model,)) for c in self._open(model)]
            if not trials:
                break
            for trial in trials:
                self._note(trial, model, "tried")
            best = max(trials, key=self._density)
            if self._density(best) < self._density(model) + self.strict.forward:
                break
            model = best
        return model

    def _exchange(self, model: Fit) -> Fit:
        """Put another effect in the place of one, as long as that predicts unseen recordings better."""
        for _ in range(self.strict.most):
            best = model
            for old in self._ordinary(model):
                rest = tuple(c for c in model.candidates if c is not old)
                for new in self._open(model):
                    if new.key != old.key:
                        trial = self._fit(_joined(rest, new), (model,))
                        if self._density(trial) > self._density(best) + self.strict.forward:
                            best = trial
            if best is model:
                return model
            model = best
        return model

    def _backward(self, model: Fit, keep_nuisances: bool = False) -> tuple[Fit, dict[str, Comparison]]:
        """Drop what fails the strict test, the weakest first."""
        while True:
            kept: dict[str, Comparison] = {}
            weakest: tuple[float, Fit, str] | None = None
            shares = self._own_share(model)
            for candidate in self._ordinary(model) if keep_nuisances else model.candidates:
                rest = tuple(c for c in model.candidates if c is not candidate)
                smaller = self._fit(rest, (model,))
                simpler = self._simpler(model, candidate)
                if simpler is not None and self._density(simpler) > self._density(smaller):
                    smaller = simpler
                comparison = self._compare(smaller, model)
                kept[candidate.label] = comparison
                lasting = self._lasts(comparison) and shares[candidate.label] >= self.strict.sensitivity
                if not lasting and (weakest is None or comparison.gain < weakest[0]):
                    weakest = (comparison.gain, smaller, candidate.label)
            if weakest is None:
                return model, kept
            self._note(weakest[1], model, f"drops {weakest[2]}")
            model = weakest[1]

    def _rivals(self, model: Fit, candidate: Candidate) -> tuple[tuple[tuple[Candidate, str], ...], tuple[Candidate, ...]]:
        """Every other effect in the place of this one: (those that lost and why, those that predict unseen data as well)."""
        rest = tuple(c for c in model.candidates if c is not candidate)
        rivals = [c for c in self._open(model) if c.key != candidate.key]
        fits = [self._fit(_joined(rest, rival), (model,)) for rival in rivals]
        surviving = confidence_set([-self._log_densities(f) for f in (model, *fits)], self.seed)
        ties = tuple(rivals[k - 1] for k in surviving if k > 0)
        rejected = tuple(
            (rival, f"predicts unseen recordings worse by {self._density(model) - self._density(fit):.0f} nats")
            for rival, fit in zip(rivals, fits, strict=True)
            if rival not in ties
        )
        return rejected, ties

    # -- parts ---------------------------------------------------------------------------------------------------

    def _lasts(self, c: Comparison) -> bool:
        return c.delta_bic > self.strict.delta_bic and c.p_value < self.strict.p_value and c.ratio >= self.strict.ratio

    def _ordinary(self, model: Fit) -> list[Candidate]:
        return [c for c in model.candidates if not c.nuisance]

    def _open(self, model: Fit) -> list[Candidate]:
        """Candidates that may be added: not in the model yet; another form only if it is richer than the one in use."""
        used = {c.key: c for c in model.candidates}
        free = []
        for candidate in self.candidates:
            present = used.get(candidate.key)
            first = candidate.form is candidate.effect.forms[0]
            if present is None or present.nuisance:
                wider = present is None or present.unknowns != candidate.unknowns
                if first and wider:
                    free.append(candidate)
            elif len(candidate.unknowns) > len(present.unknowns):
                free.append(candidate)
        return free

    def _simpler(self, model: Fit, candidate: Candidate) -> Fit | None:
        """The model with the simplest form of an effect that is there in a richer one."""
        first = candidate.effect.forms[0]
        if candidate.form is first:
            return None
        simple = next((c for c in self.candidates if c.key == candidate.key and c.form is first), None)
        if simple is None:
            return None
        rest = tuple(c for c in model.candidates if c is not candidate)
        return self._fit((*rest, simple), (model,))

    def _own_share(self, model: Fit) -> dict[str, float]:
        """For each effect, the smallest share of a parameter's influence that the other parameters cannot imitate."""
        if not model.unknowns:
            return {}
        _, slopes = jacobian(self.fitting, self.theta, model.unknowns, model.values, model.drifts)
        norms = np.linalg.norm(slopes, axis=0)
        shares = []
        for k in range(slopes.shape[1]):
            others = np.delete(slopes, k, axis=1)
            left = slopes[:, k]
            if others.shape[1]:
                weights, *_ = np.linalg.lstsq(others, left, rcond=None)
                left = left - others @ weights
            shares.append(float(np.linalg.norm(left) / norms[k]) if norms[k] > 0 else 0.0)
        result: dict[str, float] = {}
        at = 0
        for candidate in model.candidates:
            width = len(candidate.unknowns)
            result[candidate.label] = min(shares[at : at + width], default=0.0)
            at += width
        return result

    def _fit(self, candidates: tuple[Candidate, ...], parents: tuple[Fit, ...]) -> Fit:
        key = frozenset(c.label for c in candidates)
        if key not in self._fits:
            self.on_fit(", ".join(sorted(key)) or "nominal")
            self._fits[key] = fit_candidates(self.fitting, self.theta, candidates, self._starts(candidates, parents))
        return self._fits[key]

    def _starts(self, candidates: tuple[Candidate, ...], parents: tuple[Fit, ...]) -> list[Array]:
        """Known effects from each parent's optimum and from nominal; new ones from their own starts and from nominal."""
        if not candidates:
            return [np.empty(0)]
        starts = []
        for parent in (*parents, None):
            known: list[Array | None] = []
            for candidate in candidates:
                if parent is not None and candidate in parent.candidates:
                    known.append(parent.values_of(candidate))
                else:
                    known.append(None)
            rows = max((len(c.starts) for c, k in zip(candidates, known, strict=True) if k is None), default=0)
            for row in range(-1, rows):
                starts.append(np.concatenate([_start(c, k, row, parent) for c, k in zip(candidates, known, strict=True)]))
        return starts

    def _score(self, fit: Fit) -> tuple[Array, float]:
        """(log predictive density of every unseen bin, unseen RMSE in noise floors)."""
        key = frozenset(fit.labels)
        if key not in self._scores:
            parts = [
                log_density(part[0, :, k], activity, drift)
                for part, activity in zip(self.selecting.bins(fit.theta[None]), self.selecting.activities, strict=True)
                for k, drift in enumerate(fit.drifts)
            ]
            joined = np.concatenate(parts)
            self._scores[key] = joined[~np.isnan(joined)], spread_of(self.selecting.residuals(fit.theta[None]))
        return self._scores[key]

    def _log_densities(self, fit: Fit) -> Array:
        return self._score(fit)[0]

    def _density(self, fit: Fit) -> float:
        return float(self._score(fit)[0].sum())

    def _rmse(self, fit: Fit) -> float:
        return self._score(fit)[1]

    def _compare(self, smaller: Fit, larger: Fit) -> Comparison:
        extra = len(larger.unknowns) - len(smaller.unknowns)
        delta = 2.0 * (larger.log_likelihood - smaller.log_likelihood) - extra * np.log(max(self.fitting.samples, 2))
        gain = self._log_densities(larger) - self._log_densities(smaller)
        p_value = gain_p_value(gain, self.seed)
        return Comparison(float(delta), float(gain.sum()), p_value, self._rmse(smaller) / max(self._rmse(larger), 1e-12))

    def _note(self, fit: Fit, against: Fit, verdict: str) -> None:
        extra = len(fit.unknowns) - len(against.unknowns)
        delta = 2.0 * (fit.log_likelihood - against.log_likelihood) - extra * np.log(max(self.fitting.samples, 2))
        names = (f"{c.label}.{u.key}" for c in fit.candidates for u in c.unknowns)
        self._trials.append(
            Trial(
                tuple(sorted(fit.labels)),
                dict(zip(names, map(float, fit.values), strict=True)),
                spread_of(self.fitting.residuals(fit.theta[None])),
                self._rmse(fit),
                float(delta),
                verdict,
            )
        )


def _joined(model: Iterable[Candidate], new: Candidate) -> tuple[Candidate, ...]:
    """The model with ``new``, which replaces another form of the same effect (or the nuisance of that name)."""
    return (*(c for c in model if c.key != new.key), new)


def _start(candidate: Candidate, known: Array | None, row: int, parent: Fit | None) -> Array:
    if known is not None:
        return known
    if parent is not None:
        for other in parent.candidates:
            if other.key == candidate.key and row < 0:  # another form of the same effect: begin where that one ended
                slots = {at: v for u, v in zip(other.unknowns, parent.values_of(other), strict=True) for at in u.places}
                return np.array([slots.get(u.places[0], u.nominal) for u in candidate.unknowns])
    if row < 0:
        return np.array([u.nominal for u in candidate.unknowns])
    return np.array(candidate.starts[min(row, len(candidate.starts) - 1)])


def _departs(candidate: Candidate, fit: Fit) -> bool:
    """Whether any parameter moved by more than is negligible."""
    values = fit.values_of(candidate)
    return any(abs(v - u.nominal) > u.negligible for u, v in zip(candidate.unknowns, values, strict=True))
