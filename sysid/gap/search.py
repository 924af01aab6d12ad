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
from scipy.stats import qmc

from sysid.gap.candidates import Candidate
from sysid.gap.drift import log_density
from sysid.gap.evidence import Comparison, confidence_set, gain_p_value
from sysid.gap.fit import Data, Fit, fit_candidates, jacobian, spread_of
from sysid.gap.problem import Problem, Split
from sysid.gap.screen import likely_gains

Array = npt.NDArray[np.float64]

#: Starting points spread over the ranges of what is fitted; they are judged in one batch, the best are descended from.
STARTS = 32
#: An addition that leaves more than this of the unseen RMSE hardly lowers it.
SLIGHT = 0.98


@dataclass(frozen=True)
class Strictness:
    """Thresholds of the search.

    Args:
        gap: a stage whose error is below this multiple of its noise floor is explained.
        forward: least gain in log evidence that adds an effect for the time being.
        delta_bic, p_value: what an effect needs to stay, and what a rival needs to be beaten.
        likely, ratio: on short logs a few strokes decide and no block bootstrap can be sure; where the unseen recordings gain
            more than ``delta_bic`` nats this p-value is enough, or this ratio of unseen RMSE without to with the effect.
        halves: where that ratio is as large as this, ``forward`` nats are enough.
        worse: no step may raise the unseen RMSE by more than this factor, whatever short-term evidence says.
        richer: an effect that contains a simpler one has to predict unseen recordings better than that by this factor.
        decides, explained: a departure that is small enough to be negligible gets a name where the stage is explained with it
            (unseen RMSE below ``explained`` noise floors) and this many times further off without it.
        doubt: where errors add up over a run, what is negligible grows with what stays unexplained (unseen RMSE in noise
            floors), up to this factor: a model that is wrong in ways of its own moves its parameters a little wherever the
            machine is used otherwise.
        clearer: where such a stage stays unexplained, an effect has to be missed by this ratio of unseen RMSE; where it stays
            above ``strange`` noise floors, a rival has to leave so many times more as well.
        sensitivity: least share of an effect's influence that no other fitted parameter can imitate.
        most: largest number of effects at one stage.
        tried: so many of the candidates that promise most are fitted at a time.
        slight: an addition that hardly lowers the unseen RMSE needs as many nats.
        crossed: with less than this much to select on [s], fitting and selecting recordings change places as well.
        whitened, gate, free: evidence is taken on whitened residuals and on unseen recordings; what is not excited gets no
            name; gain and dead time are free in every fit. Off only to measure their worth (``pipelines/ablation.py``).
    """

    gap: float = 1.15
    forward: float = 3.0
    delta_bic: float = 10.0
    p_value: float = 0.01
    likely: float = 0.15
    ratio: float = 1.3
    halves: float = 2.0
    worse: float = 1.1
    richer: float = 1.05
    decides: float = 2.0
    explained: float = 1.5
    doubt: float = 2.5
    clearer: float = 1.25
    strange: float = 3.0
    sensitivity: float = 0.02
    most: int = 6
    tried: int = 6
    slight: float = 30.0
    crossed: float = 90.0
    whitened: bool = True
    gate: bool = True
    free: bool = True


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
        adjusted: nuisance parameters that matter, but moved too little or are too poorly shown for a name.
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
    """State of the search at one stage: a cache of fits and the table of trials.

    Args:
        candidates: what may get a name; ``nuisances``: what is free in every fit.
        gated: what the recordings cannot show well enough for a name. It may still be the reason of what is seen: where one
            of these explains it as well as what was found, that gets no name either.
    """

    problem: Problem
    theta: Array
    split: Split
    sigma: Array
    candidates: Sequence[Candidate]
    nuisances: Sequence[Candidate]
    gated: Sequence[Candidate] = ()
    strict: Strictness = field(default_factory=Strictness)
    seed: int = 0
    on_fit: Callable[[str], None] = lambda text: None
    _fits: dict[frozenset[str], tuple[Fit, ...]] = field(default_factory=dict)
    _scores: dict[frozenset[str], tuple[Array, float]] = field(default_factory=dict)
    _fitted: dict[frozenset[str], float] = field(default_factory=dict)
    _gains: dict[frozenset[str], dict[str, float]] = field(default_factory=dict)
    _trials: list[Trial] = field(default_factory=list)

    def __post_init__(self) -> None:
        fit, select = (
            Data(self.problem, part, self.sigma, self.strict.whitened) for part in (self.split.fit, self.split.select)
        )
        seconds = sum(len(r) / r.rate_hz for r in self.split.select)
        self.folds = ((fit, select), (select, fit)) if seconds < self.strict.crossed else ((fit, select),)

    def run(self) -> Finding:
        """Name what is missing, or nothing."""
        nominal = self._fit((), ())
        nominal_rmse = self._rmse(nominal)
        if nominal_rmse <= self.strict.gap:
            return Finding(self.problem, (), (), nominal, nominal_rmse, nominal_rmse)
        model = self._fit(tuple(self.nuisances), ())
        for _ in range(3):
            model, _ = self._backward(self._forward(model), keep_nuisances=True)
            better = self._plainer(self._exchange(model))
            if better is model or set(better.labels) == set(model.labels):
                break
            model = better
        doubtful = [c for c in model.candidates if not c.nuisance or self._matters(c, model)]
        rivals = {c.key: self._rivals(model, c) for c in doubtful}  # while nuisances are free: they imitate much
        model, kept = self._backward(model)
        ordinary = [
            c for c in model.candidates if not c.nuisance or (self._matters(c, model) and self._lasts(kept[c.label], model))
        ]
        named = tuple(Kept(c, kept[c.label], *rivals.get(c.key, ((), ()))) for c in ordinary)
        adjusted = tuple(c for c in model.candidates if c not in ordinary)
        seen = Data(self.problem, self.split.seen, self.sigma, self.strict.whitened)
        final = fit_candidates(seen, self.theta, model.candidates, [model.values])
        return Finding(self.problem, named, adjusted, final, nominal_rmse, self._rmse(final), tuple(self._trials))

    # -- steps ---------------------------------------------------------------------------------------------------

    def _forward(self, model: Fit) -> Fit:
        """Add what has most evidence, until nothing helps or the stage is explained."""
        passed = {frozenset(model.labels)}
        while len(self._ordinary(model)) < self.strict.most and self._rmse(model) > self.strict.gap:
            trials = [self._fit(_joined(model.candidates, c), (model,)) for c in self._likely(model, model.candidates)]
            if not trials:
                break
            for trial in trials:
                self._note(trial, model, "tried")
            limit = self.strict.worse * self._rmse(model)
            trials = [trial for trial in trials if self._rmse(trial) <= limit] or [model]
            best = max(trials, key=self._merit)
            slight = self._rmse(best) > SLIGHT * self._rmse(model)
            if self._merit(best) < self._merit(model) + (self.strict.slight if slight else self.strict.forward):
                break
            plainer = self._plainer(best)
            if frozenset(plainer.labels) in passed:  # the addition was no more than a richer form of what is there
                break
            passed.add(frozenset(plainer.labels))
            model = plainer
        return model

    def _exchange(self, model: Fit) -> Fit:
        """The model with another effect in the place of one, where that has more evidence."""
        best = model
        for old in self._ordinary(model):
            rest = tuple(c for c in model.candidates if c is not old)
            for new in self._likely(model, rest, old):
                trial = self._fit(_joined(rest, new), (model,))
                better = self._merit(trial) > self._merit(best) + self.strict.forward
                if better and self._rmse(trial) <= self.strict.worse * self._rmse(best):
                    best = trial
        return best

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
                if simpler is not None and self._merit(simpler) > self._merit(smaller):
                    smaller = simpler
                comparison = self._compare(smaller, model)
                kept[candidate.label] = comparison
                if candidate.nuisance:  # stays as an adjustment as long as it predicts better; a name needs more
                    lasting = self._merit(model) > self._merit(smaller) + self.strict.forward
                else:
                    lasting = self._lasts(comparison, model) and self._matters(candidate, model)
                lasting &= shares[candidate.label] >= self.strict.sensitivity
                if not lasting and (weakest is None or comparison.gain < weakest[0]):
                    weakest = (comparison.gain, smaller, candidate.label)
            if weakest is None:
                return model, kept
            self._note(weakest[1], model, f"drops {weakest[2]}")
            model = weakest[1]

    def _plainer(self, model: Fit) -> Fit:
        """The model with simpler effects in the place of those that contain them and hardly predict better."""
        for old in self._ordinary(model):
            rest = tuple(c for c in model.candidates if c is not old)
            taken = {c.key for c in rest}
            for new in self.candidates:
                if _contains(old, new) and new.key not in taken:
                    trial = self._fit((*rest, new), (model,))
                    self._note(trial, model, f"instead of {old.label}")
                    if self._rmse(trial) <= self.strict.richer * self._rmse(model):
                        return trial
        return model

    def _rivals(self, model: Fit, candidate: Candidate) -> tuple[tuple[tuple[Candidate, str], ...], tuple[Candidate, ...]]:
        """Every other effect in the place of this one: (those that lost and why, those that predict unseen data as well)."""
        rest = tuple(c for c in model.candidates if c is not candidate)
        rivals = self._likely(model, rest, candidate) + self._likely(model, rest, candidate, self.gated)
        fits = [self._fit(_joined(rest, rival), (model,)) for rival in rivals]
        for fit in fits:
            self._note(fit, model, f"in the place of {candidate.label}")
        # A rival ties only if neither the fitted nor the unseen recordings tell the two apart.
        near = [k for k, fit in enumerate(fits) if self._delta_bic(fit, model) < self.strict.delta_bic]
        surviving = confidence_set([-series for series in self._log_densities(model, *(fits[k] for k in near))], self.seed)
        tied = {near[k - 1] for k in surviving if k > 0}
        # What contains the effect as a special case leaves as much by itself.
        tied |= {k for k, fit in enumerate(fits) if not _contains(rivals[k], candidate) and self._as_far(fit, model)}
        ties = tuple(rivals[k] for k in sorted(tied))
        rejected = tuple(
            (
                rival,
                f"evidence: ΔBIC {self._delta_bic(fit, model):.0f} on fitted recordings, "
                f"{self._density(model) - self._density(fit):.0f} nats on unseen ones",
            )
            for rival, fit in zip(rivals, fits, strict=True)
            if rival not in ties
        )
        return rejected, ties

    def _likely(
        self,
        model: Fit,
        rest: tuple[Candidate, ...],
        old: Candidate | None = None,
        pool: Sequence[Candidate] | None = None,
    ) -> list[Candidate]:
        """Of what may be added to ``model`` the candidates that promise most beside ``rest``, the model without ``old``."""
        free = [c for c in self._open(model, pool) if old is None or c.key != old.key]
        if len(free) <= self.strict.tried:
            return free
        base = self._fit(rest, (model,))
        key = frozenset(base.labels)
        known = self._gains.setdefault(key, {})
        new = [c for c in free if c.label not in known]
        if new:
            gains = likely_gains(self.folds[0][0], self.theta, base, new)
            known.update(zip((c.label for c in new), map(float, gains), strict=True))
        return sorted(free, key=lambda c: -known[c.label])[: self.strict.tried]

    def _as_far(self, rival: Fit, model: Fit) -> bool:
        """Whether a rival leaves about as much as ``model`` of a stage that stays far from explained.

        What is left is then much larger than noise and of unknown kind, so that it may decide between the two by chance,
        however clear the evidence looks.
        """
        if self._doubtful(model) < self.strict.strange or any(_at_bound(c, rival) for c in rival.candidates):
            return False
        more = self.strict.clearer
        return self._fitted_rmse(rival) < more * self._fitted_rmse(model) and self._rmse(rival) < more * self._rmse(model)

    # -- parts ---------------------------------------------------------------------------------------------------

    def _lasts(self, c: Comparison, model: Fit) -> bool:
        """Whether evidence for an effect of ``model`` is enough to keep it."""
        if not self.strict.whitened:
            return c.delta_bic > self.strict.delta_bic
        if self._doubtful(model) > self.strict.explained and c.ratio < self.strict.clearer:
            return False
        sure = c.p_value < self.strict.p_value
        likely = c.gain > self.strict.delta_bic and (c.p_value < self.strict.likely or c.ratio > self.strict.ratio)
        halved = c.gain > self.strict.forward and c.ratio > self.strict.halves
        return c.delta_bic > self.strict.delta_bic and (sure or likely or halved)

    def _matters(self, candidate: Candidate, model: Fit) -> bool:
        """Whether a departure is large enough for a name: in itself, or since everything depends on it.

        What ends at the bound of its range is no value of that effect: something else is passed off as it.
        """
        if _at_bound(candidate, model):
            return False
        left = self._rmse(model)
        if _departs(candidate, model, float(np.clip(self._doubtful(model), 1.0, self.strict.doubt))):
            return True
        if left > self.strict.explained:
            return False
        without = self._fit(tuple(c for c in model.candidates if c is not candidate), (model,))
        return self._rmse(without) > self.strict.decides * left

    def _doubtful(self, model: Fit) -> float:
        """Noise floors that are left where errors add up over a run, so that they say less than they seem to; else none."""
        return self._rmse(model) if self.problem.integrates else 0.0

    def _ordinary(self, model: Fit) -> list[Candidate]:
        return [c for c in model.candidates if not c.nuisance]

    def _open(self, model: Fit, pool: Sequence[Candidate] | None = None) -> list[Candidate]:
        """Candidates that may be added: not in the model yet; another form only if it is richer than the one in use."""
        used = {c.key: c for c in model.candidates}
        free = []
        for candidate in self.candidates if pool is None else pool:
            if any(_contains(other, candidate) for other in model.candidates):
                continue
            present = used.get(candidate.key)
            first = candidate.form is candidate.effect.forms[0]
            if present is None or present.nuisance:
                wider = present is None or present.unknowns != candidate.unknowns
                if (first or candidate.known) and wider:
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
        _, slopes = jacobian(self.folds[0][0], self.theta, model.unknowns, model.values, model.drifts)
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
            starts = starting_values(candidates, parents, self.seed)
            fits = [fit_candidates(self.folds[0][0], self.theta, candidates, starts)]
            for data, _ in self.folds[1:]:
                fits.append(fit_candidates(data, self.theta, candidates, [fits[0].values, *starts]))
            self._fits[key] = tuple(fits)
        return self._fits[key][0]

    def _score(self, fit: Fit) -> tuple[Array, float]:
        """(log predictive density of every unseen bin, NaN where there is none, and unseen RMSE in noise floors)."""
        key = frozenset(fit.labels)
        if key not in self._scores:
            densities, left = [], []
            for (_, unseen), fitted in zip(self.folds, self._fits_of(fit), strict=True):
                for part, activity in zip(unseen.bins(fitted.theta[None]), unseen.activities, strict=True):
                    densities += [log_density(part[0, :, k], activity, d) for k, d in enumerate(fitted.drifts)]
                left += unseen.residuals(fitted.theta[None])
            self._scores[key] = np.concatenate(densities), spread_of(left)
        return self._scores[key]

    def _log_densities(self, *fits: Fit) -> Array:
        """Of the unseen bins that all of them predict, (fits, m): a clock that is wrong loses some at the ends."""
        table = np.array([self._score(fit)[0] for fit in fits])
        return np.asarray(table[:, ~np.isnan(table).any(axis=0)])

    def _density(self, fit: Fit) -> float:
        return float(np.nansum(self._score(fit)[0]))

    def _merit(self, fit: Fit) -> float:
        """Log evidence from fitted recordings (penalised for parameters) and from unseen ones together."""
        fitted = sum(
            f.log_likelihood - 0.5 * len(f.unknowns) * np.log(max(data.samples, 2))
            for (data, _), f in zip(self.folds, self._fits_of(fit), strict=True)
        )
        return float(fitted) + self._density(fit) if self.strict.whitened else float(fitted)

    def _rmse(self, fit: Fit) -> float:
        return self._score(fit)[1]

    def _fitted_rmse(self, fit: Fit) -> float:
        """Of the recordings that are fitted, in noise floors."""
        key = frozenset(fit.labels)
        if key not in self._fitted:
            self._fitted[key] = spread_of(self.folds[0][0].residuals(fit.theta[None]))
        return self._fitted[key]

    def _compare(self, smaller: Fit, larger: Fit) -> Comparison:
        gain = -np.diff(self._log_densities(larger, smaller), axis=0)[0]
        p_value = gain_p_value(gain, self.seed)
        ratio = self._rmse(smaller) / max(self._rmse(larger), 1e-12)
        return Comparison(self._delta_bic(smaller, larger), float(gain.sum()), p_value, ratio)

    def _delta_bic(self, one: Fit, other: Fit) -> float:
        """BIC(one) − BIC(other) on the fitted recordings: above zero speaks for the other."""
        extra = len(other.unknowns) - len(one.unknowns)
        total = 0.0
        for (data, _), a, b in zip(self.folds, self._fits_of(one), self._fits_of(other), strict=True):
            total += 2.0 * (b.log_likelihood - a.log_likelihood) - extra * np.log(max(data.samples, 2))
        return total

    def _fits_of(self, fit: Fit) -> tuple[Fit, ...]:
        """The fits of the same effects on every fold."""
        return self._fits[frozenset(fit.labels)]

    def _note(self, fit: Fit, against: Fit, verdict: str) -> None:
        names = (f"{c.label}.{u.key}" for c in fit.candidates for u in c.unknowns)
        self._trials.append(
            Trial(
                tuple(sorted(fit.labels)),
                dict(zip(names, map(float, fit.values), strict=True)),
                self._fitted_rmse(fit),
                self._rmse(fit),
                self._delta_bic(against, fit),
                verdict,
            )
        )


def starting_values(candidates: Sequence[Candidate], parents: Sequence[Fit], seed: int) -> list[Array]:
    """Where a fit may begin: nominal, the candidates' own starts, spread over all ranges; parents' optima with what is new."""
    if not candidates:
        return [np.empty(0)]
    nominal = np.array([u.nominal for c in candidates for u in c.unknowns])
    low = np.concatenate([_ends(c)[0] for c in candidates])
    high = np.concatenate([_ends(c)[1] for c in candidates])
    spread = low + (high - low) * qmc.Sobol(len(nominal), rng=np.random.default_rng(seed)).random(STARTS)
    rows = range(max(len(c.starts) for c in candidates))
    spread = np.vstack([spread, *(np.concatenate([c.starts[min(r, len(c.starts) - 1)] for c in candidates]) for r in rows)])
    starts = [nominal, *spread]
    for parent in parents:
        known = np.concatenate([_known(c, parent) for c in candidates])
        new = np.isnan(known)
        starts += [np.where(new, row, known) for row in (spread if new.any() else [nominal])]
        starts.append(np.where(new, nominal, known))
    return starts


def _ends(candidate: Candidate) -> tuple[Array, Array]:
    """Least and greatest of a candidate's starting values and its nominal ones.

    A nominal value far away from all of them says "absent" and leaves no room to search between: it is brought near.
    """
    table = np.array(candidate.starts)
    low, high = table.min(axis=0), table.max(axis=0)
    room = np.maximum(high - low, np.abs(table).max(axis=0))
    nominal = np.clip([u.nominal for u in candidate.unknowns], low - room, high + room)
    return np.minimum(low, nominal), np.maximum(high, nominal)


def _known(candidate: Candidate, parent: Fit) -> Array:
    """Values of a candidate at a parent's optimum (in another form of the same effect too); NaN where it is new."""
    for other in parent.candidates:
        if other is candidate:
            return parent.values_of(other)
        if other.key == candidate.key:
            slots = {at: v for u, v in zip(other.unknowns, parent.values_of(other), strict=True) for at in u.places}
            return np.array([slots.get(u.places[0], u.nominal) for u in candidate.unknowns])
    return np.full(len(candidate.unknowns), np.nan)


def _joined(model: Iterable[Candidate], new: Candidate) -> tuple[Candidate, ...]:
    """The model with ``new``, in the place of another form of it, of the nuisance of its name, and of what it contains."""
    return (*(c for c in model if c.key != new.key and not _contains(new, c)), new)


def _contains(one: Candidate, other: Candidate) -> bool:
    """Whether ``other`` is a special case of ``one``."""
    return other.effect.name in one.effect.generalises and other.target == one.target


def _departs(candidate: Candidate, fit: Fit, times: float) -> bool:
    """Whether any parameter moved by more than so many times what is negligible."""
    values = fit.values_of(candidate)
    return any(abs(v - u.nominal) > times * u.negligible for u, v in zip(candidate.unknowns, values, strict=True))


def _at_bound(candidate: Candidate, fit: Fit) -> bool:
    """Whether any parameter ends at a bound that does not mean "absent"."""
    for value, unknown in zip(fit.values_of(candidate), candidate.unknowns, strict=True):
        for bound in unknown.bounds:
            near = 1e-3 * min(unknown.bounds[1] - unknown.bounds[0], max(abs(bound), unknown.negligible))
            if abs(value - bound) <= near and abs(bound - unknown.absent) > near:
                return True
    return False
