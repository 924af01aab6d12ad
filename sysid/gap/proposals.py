"""Models of a stage to compare: forward selection by screening, then drops, swaps and richer forms around the best.

The search proposes; :mod:`sysid.gap.decision` decides. The screening is a score test (Rao, 1948) with long steps beside the
short ones, since the slope of many effects is zero where they are absent.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular
from scipy.stats import qmc

from sysid.gap.candidates import Candidate
from sysid.gap.fit import place
from sysid.gap.likelihood.block_products import factored
from sysid.gap.likelihood.stage import ModelFit, StageLikelihood, fit_model, prior_of, steps_of

Array = npt.NDArray[np.float64]

#: Largest number of effects of a stage; candidates fitted at a forward step, and in exchange for an effect.
MAX_EFFECTS, FORWARD, SWAPPED = 6, 4, 3
#: Evidence that a forward step may lose [nats]: a second effect may need the third.
MAX_LOSS = 3.0
#: Largest distance of a compared model from the best [nats].
MAX_DISTANCE = 60.0
#: Additional start values of an added effect: of one unknown whose nominal value is within their range, and of others.
FEW_STARTS, MANY_STARTS = 4, 16
#: Start values from which a fit of a grown set tries a few steps.
TRIED = 2
#: Short steps of the screening, in the negligible change of each parameter.
STEP = 2.0
#: Least and largest share of a start value along which a response is taken as linear.
SHARES = 0.05, 2.0


@dataclass(frozen=True)
class ExpectedGain:
    """Expected gain of a candidate beside a model [nats], and the start values of its fit."""

    candidate: Candidate
    gain: float
    start: Array


@dataclass
class Proposals:
    """Models of one stage under shared variances, each fitted once.

    Args:
        earlier: fits of the same sets under other variances, as start values.
    """

    likelihood: StageLikelihood
    candidates: Sequence[Candidate]
    on_fit: Callable[[str], None] = lambda text: None
    earlier: Mapping[frozenset[str], ModelFit] = field(default_factory=dict)
    fits: dict[frozenset[str], ModelFit] = field(default_factory=dict)
    _swaps: set[tuple[frozenset[str], str, str]] = field(default_factory=set, init=False)
    _screened: dict[frozenset[str], list[ExpectedGain]] = field(default_factory=dict)

    # -- single models -----------------------------------------------------------------------------------------------

    def fit(self, candidates: Sequence[Candidate], starts: Array | None = None, tried: int = 1) -> ModelFit:
        """The fit of a set from the best of ``starts`` (s, k), the ``tried`` best compared after a few steps.

        A later call with other starts may improve it.
        """
        key = frozenset(c.label for c in candidates)
        known = self.fits.get(key)
        if known is not None and starts is None:
            return known
        ordered = tuple(sorted(candidates, key=lambda c: c.label))
        if starts is not None:
            starts = np.array([_reordered(candidates, ordered, row) for row in starts])
        self.on_fit(", ".join(sorted(key)) or "nominal")
        found = fit_model(self.likelihood, ordered, _nominal(ordered)[None] if starts is None else starts, tried=tried)
        if known is None or found.evidence > known.evidence:
            self.fits[key] = found
        return self.fits[key]

    def warm(self, candidates: Sequence[Candidate], parent: ModelFit) -> ModelFit:
        """The fit of a set, started at the values of ``parent`` for the effects that both have."""
        known = self.fits.get(frozenset(c.label for c in candidates))
        if known is not None:
            return known
        return self.fit(candidates, np.concatenate([_known(c, parent) for c in candidates])[None] if candidates else None)

    def without(self, model: ModelFit, candidate: Candidate) -> ModelFit:
        return self.warm([c for c in model.candidates if c.label != candidate.label], model)

    @property
    def best(self) -> ModelFit:
        return max(self.fits.values(), key=lambda f: f.evidence)

    # -- sets of models ----------------------------------------------------------------------------------------------

    def forward(self, model: ModelFit) -> ModelFit:
        """Add the most promising candidates until the evidence falls clearly; returns the likeliest model."""
        best = model
        while len(model.candidates) < MAX_EFFECTS:
            trials = [self._added(model, promise) for promise in self.promises(model)[:FORWARD]]
            if not trials:
                break
            model = max(trials, key=lambda f: f.evidence)
            if model.evidence > best.evidence:
                best = model
            elif model.evidence < best.evidence - MAX_LOSS:
                break
        return best

    def around(self, rounds: int = 2) -> None:
        """Drops, simpler forms, additions and swaps around the likeliest model until it stays the likeliest."""
        for _ in range(rounds):
            best = self.best
            for candidate in best.candidates:
                smaller = self.without(best, candidate)
                lost = best.evidence - smaller.evidence
                for promise in self.promises(smaller)[:SWAPPED]:
                    # A candidate whose expected gain is far below the loss cannot replace the effect.
                    if _may_replace(promise.candidate, candidate) and promise.gain > 0.3 * lost - MAX_LOSS:
                        self._added(smaller, promise)
                self._with_simpler_forms(best, candidate)
            for promise in self.promises(best)[:SWAPPED]:
                self._added(best, promise)
            if self.best is best:
                break

    def _with_simpler_forms(self, model: ModelFit, candidate: Candidate) -> None:
        """Fits of a model with each simpler form of one of its effects, from the means of the values that become one.

        A forward step may take a richer form that compensates for an effect added after it.
        """
        rest = [c for c in model.candidates if c is not candidate]
        known = np.concatenate([np.empty(0), *(model.values_of(c) for c in rest)])
        for form in self.candidates:
            if candidate.extends(form):
                means = np.array([float(np.mean(model.theta[list(u.places)])) for u in form.unknowns])
                self.fit((*rest, form), np.concatenate([known, means])[None])

    def grown(self, models: Sequence[ModelFit], among: Collection[str], most: int) -> list[ModelFit]:
        """Models with one more of the candidates ``among`` these labels, the ``most`` that are expected to be likeliest.

        Two effects that explain little may explain much with a third one. Each candidate is tried alone.
        """
        ways = [(model, promise) for model in models for promise in self.promises(model) if promise.candidate.label in among]
        found: dict[frozenset[str], ModelFit] = {}
        for model, promise in sorted(ways, key=lambda way: -(way[0].evidence + way[1].gain)):
            labels = frozenset(c.label for c in (*_beside(promise.candidate, model), promise.candidate))
            if labels not in found and (not model.candidates or len(found) < most):
                found[labels] = self._added(model, promise, TRIED if model.candidates else 1)
        return list(found.values())

    def swapped(self, model: ModelFit, among: Collection[str]) -> list[ModelFit]:
        """A model with each effect replaced by the most promising candidates ``among`` these labels, also by itself.

        The other effects start at their values in the model: fitted without the effect they would take its part.
        """
        found = []
        for candidate in model.candidates:
            rest = _beside(candidate, model)
            less = fit_model(self.likelihood, rest, np.concatenate([model.values_of(c) for c in rest])[None], rounds=0)
            promises = [p for p in screened(self.likelihood, less, self._open(less)) if p.candidate.label in among]
            for promise in sorted(promises, key=lambda p: -p.gain)[:SWAPPED]:
                step = model.labels, candidate.label, promise.candidate.label
                if step not in self._swaps:
                    self._swaps.add(step)
                    found.append(self._fitted(less, promise, TRIED))
        return found

    def near(self) -> list[ModelFit]:
        """Models close to the best, likeliest first, the one without effects among them."""
        empty = self.fit(())
        ordered = sorted(self.fits.values(), key=lambda f: -f.evidence)
        found = [f for f in ordered if f.evidence > ordered[0].evidence - MAX_DISTANCE]
        return found if any(f is empty for f in found) else [*found, empty]

    def promises(self, model: ModelFit) -> list[ExpectedGain]:
        """Candidates that may be added to a model, largest expected gain first."""
        if model.labels not in self._screened:
            found = screened(self.likelihood, model, self._open(model))
            self._screened[model.labels] = sorted(found, key=lambda p: -p.gain)
        return self._screened[model.labels]

    def _added(self, model: ModelFit, promise: ExpectedGain, tried: int = 1) -> ModelFit:
        key = frozenset(c.label for c in (*_beside(promise.candidate, model), promise.candidate))
        return self.fits[key] if key in self.fits else self._fitted(model, promise, tried)

    def _fitted(self, model: ModelFit, promise: ExpectedGain, tried: int) -> ModelFit:
        """A model with one more candidate, fitted from its start values and from those of the others in the model."""
        new, rest = promise.candidate, _beside(promise.candidate, model)
        key = frozenset(c.label for c in (*rest, new))
        known = np.concatenate([np.empty(0), *(model.values_of(c) for c in rest)])
        before = self.earlier.get(key)
        spread = _spread(new) if before is None else np.array([before.values_of(new)])
        starts = np.array([np.concatenate([known, start]) for start in (promise.start, *new.starts, *spread)])
        if before is not None:
            starts = np.vstack([starts, np.concatenate([before.values_of(c) for c in (*rest, new)])])
        return self.fit((*rest, new), starts, tried)

    def _open(self, model: ModelFit) -> list[Candidate]:
        """Candidates that are not in the model yet; a richer form where its simpler one is there."""
        used = {c.key: c for c in model.candidates}
        found = []
        for candidate in self.candidates:
            present = used.get(candidate.key)
            simple = candidate.known or not any(candidate.extends(other) for other in self.candidates)
            if any(other.contains(candidate) for other in model.candidates):
                continue
            if simple if present is None else candidate.extends(present):
                found.append(candidate)
        return found


def _beside(new: Candidate, model: ModelFit) -> list[Candidate]:
    """The effects of a model that stay when ``new`` is added."""
    return [c for c in model.candidates if c.key != new.key and not new.contains(c)]


def _may_replace(new: Candidate, old: Candidate) -> bool:
    """Whether ``new`` is another effect than ``old``, or another form of it with as many values."""
    return new.key != old.key or (new.label != old.label and len(new.unknowns) == len(old.unknowns))


def screened(likelihood: StageLikelihood, model: ModelFit, candidates: Sequence[Candidate]) -> list[ExpectedGain]:
    """Expected gain of each candidate beside ``model`` for a linear response."""
    lanes, owners, starts, whole = _lanes(model.theta, candidates)
    if not len(lanes):
        return []
    steps, prior = steps_of(model.unknowns, model.values), prior_of(model.candidates)
    moved = place(likelihood.rows.theta, model.unknowns, model.values + np.diag(steps))
    count, m = len(lanes), len(model.unknowns)
    p = likelihood.linear.columns.shape[1] + m
    products = np.zeros((p + count + 1,) * 2)  # of linear part, slopes of the model, changes, and residual
    for here, part in likelihood.innovation_parts(np.vstack([model.theta[None], lanes, moved])):
        w, changes, slopes = part[:, :1], part[:, 1 : count + 1], part[:, count + 1 :]
        table = np.hstack([likelihood.linear.columns[here], (slopes - w) / steps * prior.width, changes - w, w])
        products += table.T @ table
    factor = factored(products[:p, :p] + np.eye(p))
    right = products[:p, p:].copy()
    right[p - m :, -1] += (model.values - prior.centre) / prior.width
    z = solve_triangular(factor, right, lower=True)
    left = products[p:, p:] - z.T @ z
    gram, slope = left[:-1, :-1], -left[:-1, -1]  # how the cost falls with each change
    found = []
    for k, candidate in enumerate(candidates):
        best = ExpectedGain(candidate, -np.inf, np.array(candidate.starts[0]))
        nominal = np.array([model.theta[u.places[0]] for u in candidate.unknowns])
        for at in np.flatnonzero((owners == k) & whole):
            share, gain = along(slope[at], gram[at, at])
            if gain > best.gain:
                best = ExpectedGain(candidate, float(gain), nominal + share * (starts[at] - nominal))
        short = np.flatnonzero((owners == k) & ~whole)
        G = gram[np.ix_(short, short)] + 1e-9 * np.trace(gram[np.ix_(short, short)]) * np.eye(len(short))
        if len(short) and float(np.trace(G)) > 0.0:
            weights = np.linalg.solve(G + 1e-300 * np.eye(len(short)), slope[short])
            moved = nominal + weights * np.array([(starts[at] - nominal).sum() for at in short])
            gain = float(0.5 * weights @ slope[short])
            low, high = (np.array([u.bounds[e] for u in candidate.unknowns]) for e in (0, 1))
            inside = bool(((moved >= low) & (moved <= high)).all())
            if inside and gain > best.gain:
                best = ExpectedGain(candidate, gain, moved)
        found.append(best)
    return found


def along(slope: Any, square: Any) -> tuple[Any, Any]:
    """Best shares of changes to which the response is linear, within :data:`SHARES`, and their gains in half the cost.

    Args:
        slope: products of changes and residual; ``square``: of changes with themselves, of the same shape.
    """
    share = np.clip(slope / np.maximum(square, 1e-12), *SHARES)
    return share, share * slope - 0.5 * share**2 * square


def _lanes(
    theta: Array, candidates: Sequence[Candidate]
) -> tuple[Array, npt.NDArray[np.int64], list[Array], npt.NDArray[np.bool_]]:
    """Parameter vectors, index of the candidate of each, its values, and whether it is a start value (or a short step)."""
    lanes, owners, values, whole = [], [], [], []
    for k, candidate in enumerate(candidates):
        nominal = np.array([theta[u.places[0]] for u in candidate.unknowns])
        rows = [(np.array(start), True) for start in candidate.starts]
        for j, unknown in enumerate(candidate.unknowns):
            moved = nominal.copy()
            step = STEP * unknown.negligible
            moved[j] += step if moved[j] + step <= unknown.bounds[1] else -step
            rows.append((moved, False))
        for row, is_whole in rows:
            lanes.append(place(theta, candidate.unknowns, row[None])[0])
            owners.append(k)
            values.append(row)
            whole.append(is_whole)
    return np.array(lanes), np.array(owners), values, np.array(whole, dtype=bool)


def _spread(candidate: Candidate) -> Array:
    """Start values between and around those of a candidate, (s, k): a frequency or a length needs a close one."""
    table = np.array(candidate.starts)
    low, high = table.min(axis=0), table.max(axis=0)
    margin = np.maximum(high - low, 0.5 * np.abs(high))
    bounds = np.array([u.bounds for u in candidate.unknowns])
    nominal = candidate.unknowns[0].nominal
    low = np.maximum(np.where(low > 0.0, 0.3 * low, low - 0.5 * margin), bounds[:, 0])
    high = np.minimum(high + 0.5 * margin, bounds[:, 1])
    draws = qmc.Sobol(len(low), rng=np.random.default_rng(0)).random(
        FEW_STARTS if len(low) == 1 and low[0] <= nominal <= high[0] else MANY_STARTS
    )
    logarithmic = low > 0.0
    floor = np.where(logarithmic, low, 1.0)
    return np.where(logarithmic, floor * (np.where(logarithmic, high, 1.0) / floor) ** draws, low + (high - low) * draws)


def _nominal(candidates: Sequence[Candidate]) -> Array:
    return np.array([u.nominal for c in candidates for u in c.unknowns])


def _reordered(given: Sequence[Candidate], ordered: Sequence[Candidate], values: Array) -> Array:
    """Values in the order of ``ordered``."""
    at, parts = 0, {}
    for candidate in given:
        parts[candidate.label] = values[at : at + len(candidate.unknowns)]
        at += len(candidate.unknowns)
    return np.concatenate([parts[c.label] for c in ordered]) if ordered else np.empty(0)


def _known(candidate: Candidate, parent: ModelFit) -> Array:
    """Values of a candidate in ``parent``; those of its parameter vector where it is not in the model."""
    for other in parent.candidates:
        if other.label == candidate.label:
            return parent.values_of(other)
    return np.array([parent.theta[u.places[0]] for u in candidate.unknowns])
