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

from sysid.datasets.recording import Recording
from sysid.gap.candidates import Candidate
from sysid.gap.data import Data
from sysid.gap.evidence import Comparison
from sysid.gap.finding import Finding, Kept, Trial
from sysid.gap.fit import Fit, fit_candidates, spread_of
from sysid.gap.makeshift import makeshift
from sysid.gap.problem import Problem, Split
from sysid.gap.scores import Scores
from sysid.gap.screen import likely_gains
from sysid.gap.strictness import Strictness
from sysid.gap.ties import Ties
from sysid.gap.worth import Worth

Array = npt.NDArray[np.float64]

#: An addition that leaves more than this of the unseen RMSE hardly lowers it.
SLIGHT = 0.98


@dataclass
class Search:
    """State of the search at one stage: the fits with their scores, and the table of trials.

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
    scores: Scores = field(init=False)
    worth: Worth = field(init=False)
    ties: Ties = field(init=False)
    _gains: dict[frozenset[str], dict[str, float]] = field(default_factory=dict)
    _trials: list[Trial] = field(default_factory=list)

    def __post_init__(self) -> None:
        fit, select = self._data(self.split.fit), self._data(self.split.select)
        crossed = sum(len(r) / r.rate_hz for r in self.split.select) < self.strict.crossed
        before, after = (spread_of(data.residuals(self.theta[None])) for data in (fit, select))
        if before > max(self.strict.unshown * after, self.strict.gap):
            fit, select = self._dealt()
            crossed = True
        folds = ((fit, select), (select, fit)) if crossed else ((fit, select),)
        self.scores = Scores(self.theta, folds, self.strict.whitened, self.seed, self.on_fit)
        self.worth = Worth(self.scores, self.strict, self.problem)
        self.ties = Ties(self.scores, self.strict, self.worth, self.seed)

    def _data(self, recordings: Sequence[Recording]) -> Data:
        return Data(self.problem, recordings, self.sigma, self.strict.whitened)

    def _dealt(self) -> tuple[Data, Data]:
        """What may be seen, in halves that show as much of the gap: by turns, from the recording that shows most of it."""
        shown = [spread_of(self._data((r,)).residuals(self.theta[None])) for r in self.split.seen]
        order = [self.split.seen[k] for k in np.argsort(shown, kind="stable")[::-1]]
        return self._data(order[0::2]), self._data(order[1::2])

    def run(self) -> Finding:
        """Name what is missing, or nothing."""
        nominal = self.scores.fit((), ())
        nominal_rmse = self.scores.rmse(nominal)
        if nominal_rmse <= self.strict.gap:
            return Finding(self.problem, (), (), nominal, nominal_rmse, nominal_rmse)
        model = self.scores.fit(tuple(self.nuisances), ())
        if self.scores.rmse(model) > self.strict.short * nominal_rmse:  # a sensor that reads in steps favours what stands still
            model = nominal
        start, model = model, self._grown(model)
        if droops := self.worth.droops(model):
            self._gate(droops)
            model = self._grown(start)
        while crumbs := [c for c in self.worth.crumbs(model) if not c.nuisance]:
            model = self._cleared(model, crumbs)
        misshapen = self.worth.misshapen(model)
        if any(not c.nuisance for c in misshapen):
            model = self._cleared(model, misshapen)
        doubtful = [c for c in model.candidates if not c.nuisance or self.worth.matters(c, model)]
        rivals = {c.key: self._rivals(model, c) for c in doubtful}  # while nuisances are free: they imitate much
        model, kept = self._backward(model)
        seen = self._data(self.split.seen)
        final = fit_candidates(seen, self.theta, model.candidates, [model.values])
        unnamed = (*self.worth.crumbs(model), *misshapen)
        instead = makeshift(model, self.worth.strange(model))
        ordinary = [
            c
            for c in model.candidates
            if c not in instead
            and (
                not c.nuisance
                or (c not in unnamed and self.worth.matters(c, model, final) and self.worth.lasts(kept[c.label], model))
            )
        ]
        named = tuple(Kept(c, kept[c.label], *rivals.get(c.key, ((), ()))) for c in ordinary)
        adjusted = tuple(c for c in model.candidates if c not in ordinary)
        final_rmse, leeway = self.scores.rmse(final), self.worth.leeway(model)
        return Finding(self.problem, named, adjusted, final, nominal_rmse, final_rmse, tuple(self._trials), leeway)

    # -- steps ---------------------------------------------------------------------------------------------------

    def _grown(self, model: Fit) -> Fit:
        """Forward, backward, and again while something else in the place of an effect does better."""
        for _ in range(3):
            model, _ = self._backward(self._forward(model), keep_nuisances=True)
            better = self._plainer(self._exchange(model))
            if better is model or set(better.labels) == set(model.labels):
                break
            model = better
        return model

    def _gate(self, found: Sequence[Candidate]) -> None:
        """These get no name here, and none is given where one of them does as well."""
        keys = {c.key for c in found}
        self.gated = (*self.gated, *found)
        self.candidates = tuple(c for c in self.candidates if c.key not in keys)

    def _forward(self, model: Fit) -> Fit:
        """Add what has most evidence, until nothing helps or the stage is explained."""
        passed = {frozenset(model.labels)}
        while len(self._ordinary(model)) < self.strict.most and self.scores.rmse(model) > self.strict.gap:
            trials = [self.scores.fit(_joined(model.candidates, c), (model,)) for c in self._likely(model, model.candidates)]
            if not trials:
                break
            for trial in trials:
                self._note(trial, model, "tried")
            limit = self.strict.worse * self.scores.rmse(model)
            trials = [trial for trial in trials if self.scores.rmse(trial) <= limit] or [model]
            best = max(trials, key=self.scores.merit)
            slight = self.scores.rmse(best) > SLIGHT * self.scores.rmse(model)
            if self.scores.merit(best) < self.scores.merit(model) + (self.strict.slight if slight else self.strict.forward):
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
                trial = self.scores.fit(_joined(rest, new), (model,))
                better = self.scores.merit(trial) > self.scores.merit(best) + self.strict.forward
                if better and self.scores.rmse(trial) <= self.strict.worse * self.scores.rmse(best):
                    best = trial
        return best

    def _backward(self, model: Fit, keep_nuisances: bool = False) -> tuple[Fit, dict[str, Comparison]]:
        """Drop what fails the strict test, the weakest first."""
        while True:
            kept: dict[str, Comparison] = {}
            weakest: tuple[float, Fit, str] | None = None
            shares = self.scores.own_shares(model)
            for candidate in self._ordinary(model) if keep_nuisances else model.candidates:
                smaller = self.scores.without(candidate, model)
                simpler = self._simpler(model, candidate)
                if simpler is not None and self.scores.merit(simpler) > self.scores.merit(smaller):
                    smaller = simpler
                comparison = self.scores.compare(smaller, model)
                kept[candidate.label] = comparison
                if candidate.nuisance:  # stays as an adjustment as long as it predicts better; a name needs more
                    lasting = self.scores.merit(model) > self.scores.merit(smaller) + self.strict.forward
                else:
                    lasting = self.worth.lasts(comparison, model) and self.worth.matters(candidate, model)
                lasting &= shares[candidate.label] >= self.strict.sensitivity
                if not lasting and (weakest is None or comparison.gain < weakest[0]):
                    weakest = (comparison.gain, smaller, candidate.label)
            if weakest is None:
                return model, kept
            self._note(weakest[1], model, f"drops {weakest[2]}")
            model = weakest[1]

    def _cleared(self, model: Fit, of: Sequence[Candidate]) -> Fit:
        """The model without the ordinary ones of some effects, and without what only they had needed."""
        rest = tuple(c for c in model.candidates if c.nuisance or c not in of)
        return self._backward(self.scores.fit(rest, (model,)), keep_nuisances=True)[0]

    def _plainer(self, model: Fit) -> Fit:
        """The model with simpler effects in the place of those that contain them and hardly predict better."""
        for old in self._ordinary(model):
            rest = tuple(c for c in model.candidates if c is not old)
            taken = {c.key for c in rest}
            for new in self.candidates:
                if old.contains(new) and new.key not in taken:
                    trial = self.scores.fit((*rest, new), (model,))
                    self._note(trial, model, f"instead of {old.label}")
                    if self.scores.rmse(trial) <= self.strict.richer * self.scores.rmse(model):
                        return trial
        return model

    def _rivals(self, model: Fit, candidate: Candidate) -> tuple[tuple[tuple[Candidate, str], ...], tuple[Candidate, ...]]:
        """Every other effect in the place of this one: (those that lost and why, those that predict unseen data as well)."""
        rest = tuple(c for c in model.candidates if c is not candidate)
        rivals = self._likely(model, rest, candidate) + self._likely(model, rest, candidate, self.gated)
        fits = [self.scores.fit(_joined(rest, rival), (model,)) for rival in rivals]
        for fit in fits:
            self._note(fit, model, f"in the place of {candidate.label}")
        return self.ties.judged(model, candidate, rivals, fits)

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
        base = self.scores.fit(rest, (model,))
        key = frozenset(base.labels)
        known = self._gains.setdefault(key, {})
        new = [c for c in free if c.label not in known]
        if new:
            gains = likely_gains(self.scores.fitted, self.theta, base, new)
            known.update(zip((c.label for c in new), map(float, gains), strict=True))
        return sorted(free, key=lambda c: -known[c.label])[: self.strict.tried]

    # -- parts ---------------------------------------------------------------------------------------------------

    def _ordinary(self, model: Fit) -> list[Candidate]:
        return [c for c in model.candidates if not c.nuisance]

    def _open(self, model: Fit, pool: Sequence[Candidate] | None = None) -> list[Candidate]:
        """Candidates that may be added: not in the model yet; another form only if it is richer than the one in use."""
        used = {c.key: c for c in model.candidates}
        free = []
        for candidate in self.candidates if pool is None else pool:
            if any(other.contains(candidate) for other in model.candidates):
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
        return self.scores.fit((*rest, simple), (model,))

    def _note(self, fit: Fit, against: Fit, verdict: str) -> None:
        names = (f"{c.label}.{u.key}" for c in fit.candidates for u in c.unknowns)
        self._trials.append(
            Trial(
                tuple(sorted(fit.labels)),
                dict(zip(names, map(float, fit.values), strict=True)),
                self.scores.fitted_rmse(fit),
                self.scores.rmse(fit),
                self.scores.delta_bic(against, fit),
                verdict,
            )
        )


def _joined(model: Iterable[Candidate], new: Candidate) -> tuple[Candidate, ...]:
    """The model with ``new``, in the place of another form of it, of the nuisance of its name, and of what it contains."""
    return (*(c for c in model if c.key != new.key and not new.contains(c)), new)
