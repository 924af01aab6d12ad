"""The end-effector stage of a pose set, from its poses to a decision: linearise → sizes → sets of effects → decision.

Geometry, sensors, compliance and the frame of the measurement are in one search from the start: calibrated one after the other,
the first would absorb what the others cause. The tip is a smooth function of all unknowns, so the search runs in the linearised
model, which is renewed at the values of the set found until both stay. A set costs a small Cholesky factorisation there, so
that all exchanges of the catalogue are tested instead of a few promising ones.

In units of the priors, the poses determine a direction of the unknowns where the posterior deviation is well below the prior's.
Directions that are not determined are sparse after a rotation to few members (varimax: Kaiser, Psychometrika 23 (1958),
187–200), so that each reads as a sentence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial

import numpy as np
import numpy.typing as npt

from sysid.gap.arm.effect_sets import GAIN, Index, Set, densities_of_blocks, gain_of_errors, places, unknowns_of
from sysid.gap.arm.pose_rows import PoseRows
from sysid.gap.candidates import Candidate
from sysid.gap.data import SearchInput
from sysid.gap.decision import Decision, FreeRun, decide
from sysid.gap.fit import place
from sysid.gap.likelihood.explained import Explained
from sysid.gap.likelihood.gaussian_regression import NOISE_SPREAD, UNDETERMINED, GaussianRegression, Posterior, Sizes
from sysid.gap.likelihood.stage import ModelFit, prior_of
from sysid.gap.stage_model import StageFit
from sysid.gap.thresholds import LEAST

Array = npt.NDArray[np.float64]

#: Targets of effects of the measurement, with which every search begins: its frame, and the measured point where it is not
#: surveyed. Other effects of the stage belong to an axis or a sensor.
MEASUREMENT = ("base", "ee")
#: Rounds of search and linearisation.
ROUNDS = 6
#: Further models beside those without an effect: exchanges and additions, the likeliest.
NEIGHBOURS = 40
#: Largest number of effects: as many as the poses determine, at least so many rows for each unknown.
ROWS_PER_UNKNOWN = 3
#: Exchanges, additions and drops at most; each raises the evidence.
MOST_STEPS = 200
#: Members of a combination below this weight are left out of its sentence; largest number of members that make a sentence.
LEAST_WEIGHT, MOST_MEMBERS = 0.3, 4
#: Iterations of the rotation.
TURNS = 50


def fit_pose_stage(given: SearchInput) -> StageFit:
    """Search and decide the end-effector stage of static poses.

    Effects that the poses do not excite are left out: they would absorb the errors of others. The frame of the measurement
    stays, whether the poses determine it or not.
    """
    seen, nameable, on_fit = given.seen, given.nameable, given.on_fit
    rows = PoseRows(given.model, seen.problem, seen.recordings, given.theta, seen.sigma)
    there = [c for c in given.candidates if c.label in nameable or c.effect.target in MEASUREMENT]
    fitting = _Fitting(rows, there)
    search, best = fitting.converged(on_fit)
    fitting.weights = rows.weights(fitting.residual(search, best))
    search, best = fitting.converged(on_fit, best)
    return _decided(fitting, search, best, nameable)


@dataclass
class SetSearch:
    """Sets of ``candidates``, by number, in the regression on the unknowns of all of them; each evaluated once."""

    regression: GaussianRegression
    candidates: Sequence[Candidate]
    known: dict[Set, Posterior] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._places = places(self.candidates)

    def unknowns(self, members: Set) -> Index:
        """Indices of the unknowns of a set."""
        return unknowns_of(self._places, members)

    def posterior(self, members: Set) -> Posterior:
        if members not in self.known:
            self.known[members] = self.regression.posterior(self.unknowns(members))
        return self.known[members]

    def evidence(self, members: Set) -> float:
        """Of a set; minus infinity where a value leaves its bounds, or where it has too many unknowns for the rows."""
        if ROWS_PER_UNKNOWN * len(self.unknowns(members)) > self.regression.rows:
            return -np.inf
        found = self.posterior(members)
        return found.evidence if found.inside else -np.inf

    def likeliest(self, start: Set) -> Set:
        """The set from which no addition, drop or exchange raises the evidence."""
        best = start if np.isfinite(self.evidence(start)) else frozenset()
        for _ in range(MOST_STEPS):
            for neighbours in (self.larger, self.smaller, self.exchanged):
                found = max(neighbours(best), key=self.evidence, default=best)
                if self.evidence(found) > self.evidence(best) + GAIN:
                    best = found
                    break
            else:
                return best
        return best

    def larger(self, members: Set) -> list[Set]:
        return [self._joined(members, k) for k in range(len(self.candidates)) if k not in members]

    def smaller(self, members: Set) -> list[Set]:
        return [members - {k} for k in sorted(members)]

    def exchanged(self, members: Set) -> list[Set]:
        """One effect in place of one or two others."""
        less = [members - {k} for k in sorted(members)]
        return [new for rest in less for new in self.larger(rest) if new != members]

    def _joined(self, members: Set, new: int) -> Set:
        """The set with a candidate, without its special cases and other forms of it."""
        one = self.candidates[new]
        rest = (k for k in members if self.candidates[k].key != one.key and not one.contains(self.candidates[k]))
        return frozenset((*rest, new))

    def undetermined(self) -> Iterator[str]:
        """A sentence for each combination of the unknowns of all candidates that the poses do not determine."""
        names = [f"{c.effect.name}({c.target}).{u.key}" for c in self.candidates for u in c.unknowns]
        if not names:
            return
        whole, _ = self.regression.marginal
        plausible = np.array([_plausible(c.starts, k) for c in self.candidates for k in range(len(c.unknowns))])
        gram = whole[:-1, :-1] * np.outer(plausible, plausible)
        values, vectors = np.linalg.eigh(gram)
        open_ = vectors[:, 1.0 / np.sqrt(1.0 + np.maximum(values, 0.0)) > UNDETERMINED]
        for direction in _sparse(open_).T:
            summands = [name for name, weight in zip(names, direction, strict=True) if abs(weight) >= LEAST_WEIGHT]
            if 2 <= len(summands) <= MOST_MEMBERS:
                yield f"these poses do not separate {' and '.join(summands)}: only their sum is determined"


def _plausible(starts: tuple[tuple[float, ...], ...], k: int) -> float:
    """Plausible size of an unknown: half the spread of its start values, else 0.01 (m or rad)."""
    return float(np.ptp([row[k] for row in starts])) / 2.0 or 0.01


def _sparse(loadings: Array) -> Array:
    """Varimax rotation of orthonormal directions (k, m)."""
    turned = loadings
    for _ in range(TURNS if loadings.shape[1] > 1 else 0):
        u, _, vt = np.linalg.svd(loadings.T @ (turned**3 - turned * (turned**2).mean(axis=0)))
        turned = loadings @ (u @ vt)
    return turned


class _Fitting:
    """The regression of a pose set at the current linearisation, sizes and weights."""

    def __init__(self, rows: PoseRows, candidates: Sequence[Candidate]) -> None:
        self.rows, self.candidates = rows, tuple(candidates)
        self.unknowns = tuple(u for c in candidates for u in c.unknowns)
        self.prior = prior_of(self.candidates)
        self.nominal = np.array([u.nominal for u in self.unknowns])
        self.values = self._registered()
        self.weights = np.ones(rows.poses)
        self.sizes: Sizes | None = None

    def _registered(self) -> Array:
        """Nominal values, with those of the measurement fitted to the described geometry."""
        owners = [candidate for candidate in self.candidates for _ in candidate.unknowns]
        frame = [k for k, owner in enumerate(owners) if owner.effect.target in MEASUREMENT]
        values = self.nominal.copy()
        if frame:
            values[frame] = self.rows.registered([self.unknowns[k] for k in frame], self.nominal[frame])
        return np.asarray(np.clip(values, self.prior.low, self.prior.high))

    @property
    def base(self) -> Set:
        """The effects of :data:`MEASUREMENT`, with which every search begins."""
        return frozenset(k for k, c in enumerate(self.candidates) if c.effect.target in MEASUREMENT)

    def search(self) -> SetSearch:
        """The regression linearised at the current values, under the current sizes."""
        whole = place(self.rows.theta, self.unknowns, self.values[None])[0]
        residual, slopes = self.rows.linearised(whole, self.unknowns)
        target = residual + slopes @ (self.values - self.nominal)
        weights = self.rows.by_row(self.weights)
        columns, errors = slopes * weights[:, None], self.rows.tangents * weights[:, None]
        kinds = int(self.rows.kind.max(initial=-1)) + 1
        sizes = self.sizes or Sizes(np.full(kinds, 1e-4), 1.0)
        found = GaussianRegression(
            target * weights, columns, errors, self.rows.kind, self.prior, self.nominal, self.rows.measured, sizes
        )
        if self.sizes is None:  # beside every effect, so that what an effect explains is not an error of the arm
            self.sizes = found.with_sizes(np.arange(len(self.unknowns), dtype=np.intp))
            found = found.under(self.sizes)
        return SetSearch(found, self.candidates)

    def converged(self, on_fit: Callable[[str], None], best: Set | None = None) -> tuple[SetSearch, Set]:
        """Set of effects, values and sizes that stay when each is renewed beside the others."""
        best = self.base if best is None else best
        search = self.search()
        for _ in range(ROUNDS):
            starts = {best, self.base}
            found = max((search.likeliest(start) for start in starts), key=search.evidence)
            on_fit(", ".join(sorted(self.candidates[k].label for k in found)) or "nominal")
            moved = self._renewed(search, found)
            again = self.search()
            if found == best and moved < 1.0:
                return again, found
            best, search = found, again
        return search, best

    def _renewed(self, search: SetSearch, members: Set) -> float:
        """Values and sizes beside a set; returns the largest change of a value in its negligible change."""
        at = search.unknowns(members)
        values = self.nominal.copy()
        values[at] += search.posterior(members).change
        values = np.clip(values, self.prior.low, self.prior.high)
        scale = np.array([u.negligible for u in self.unknowns])
        moved = float(np.max(np.abs(values - self.values) / scale, initial=0.0))
        self.values, self.sizes = values, search.regression.with_sizes(at)
        return moved

    def residual(self, search: SetSearch, members: Set) -> Array:
        """Residual beside the effects of a set, (rows,) in noise floors, before weighting."""
        change = search.regression.columns[:, search.unknowns(members)] @ search.posterior(members).change
        return np.asarray((search.regression.target - change) / self._by_row)

    @property
    def _by_row(self) -> Array:
        """Weight of each row, (rows,), never zero."""
        return np.maximum(self.rows.by_row(self.weights), 1e-9)

    def model_of(self, search: SetSearch, members: Set) -> ModelFit:
        """A set as a model of the decision, with the predictive density of each block of poses."""
        regression, at, found = search.regression, search.unknowns(members), search.posterior(members)
        unknowns = tuple(self.unknowns[k] for k in at)
        values = np.clip(regression.nominal[at] + found.change, regression.prior.low[at], regression.prior.high[at])
        effects = regression.columns[:, at]
        residual, count = self.residual(search, members), max(regression.rows, 1)
        left = float(np.sqrt(residual @ residual / count))
        return ModelFit(
            candidates=tuple(self.candidates[k] for k in sorted(members)),
            unknowns=unknowns,
            values=values,
            theta=place(self.rows.theta, unknowns, values[None])[0],
            covariance=found.covariance,
            confounded=np.zeros(len(at)),  # the covariance contains what the errors of the arm could do in its place
            evidence=found.evidence,
            predictive=densities_of_blocks(regression, at, self.rows.block, self.rows.blocks),
            rms=left / regression.sizes.noise,
            response=np.sqrt(((effects / self._by_row[:, None]) ** 2).sum(axis=0) / count),
            left=left,
        )


@dataclass(frozen=True, eq=False)
class _Sets:
    """Sets of effects as models that the rule compares (:class:`sysid.gap.decision.Compared`)."""

    fitting: _Fitting
    search: SetSearch
    nameable: Sequence[str]
    sets: dict[Set, None]
    integrates: bool = False
    independent: bool = True
    free: FreeRun = field(default_factory=FreeRun)

    @cached_property
    def model_of(self) -> Callable[[Set], ModelFit]:
        return cache(partial(self.fitting.model_of, self.search))

    @property
    def models(self) -> Sequence[ModelFit]:
        return [self.model_of(s) for s in self.sets]

    @property
    def frame(self) -> frozenset[str]:
        return frozenset(self.search.candidates[k].label for k in self.fitting.base)

    def members_of(self, model: ModelFit) -> Set:
        return frozenset(k for k, c in enumerate(self.search.candidates) if c.label in model.labels)

    def own_evidence(self, model: ModelFit) -> float:
        return model.evidence

    def discrepancy_gain(self, model: ModelFit) -> float:
        """Gain in evidence by the errors of the arm.

        Poses that scatter by more than their noise can are wrong by something else, whether these errors describe it or not.
        """
        regression = self.search.regression
        if regression.sizes.noise > np.exp(2.0 * NOISE_SPREAD):
            return float(np.inf)
        return gain_of_errors(regression, self.search.unknowns(self.members_of(model)))

    def without(self, model: ModelFit, candidate: Candidate) -> ModelFit:
        return self.model_of(frozenset(k for k in self.members_of(model) if self.search.candidates[k].label != candidate.label))

    def fewest(self, model: ModelFit) -> Sequence[ModelFit] | None:
        return None


def _decided(fitting: _Fitting, search: SetSearch, best: Set, nameable: Sequence[str]) -> StageFit:
    # A larger set that is clearly less likely cannot be preferred: its further effect is not a near miss.
    richer = [s for s in search.larger(best) if search.evidence(s) > search.evidence(best) - LEAST]
    near = sorted((*search.exchanged(best), *richer), key=search.evidence, reverse=True)
    near = [s for s in near if np.isfinite(search.evidence(s))][:NEIGHBOURS]
    sets = dict.fromkeys((best, *search.smaller(best), *near, fitting.base, frozenset()))
    compared = _Sets(fitting, search, nameable, sets)
    model_of, members_of = compared.model_of, compared.members_of
    decision = decide(compared)
    for _ in range(4):
        more = [s for f in (decision.model, *decision.acceptable) for s in search.smaller(members_of(f)) if s not in sets]
        if not more:
            break
        sets.update(dict.fromkeys(more))
        decision = decide(compared)
    decision = _with_confounded(decision, search, members_of(decision.model))
    chosen = decision.model
    return StageFit(
        tuple(sorted((model_of(s) for s in sets), key=lambda f: -f.evidence)),
        decision,
        {c.label: compared.without(chosen, c) for c in chosen.candidates},
        Explained(chosen.left, float(search.regression.sizes.noise), {}),
        chosen,
        combinations=tuple(search.undetermined()),
        framed=model_of(fitting.base),
    )


def _with_confounded(decision: Decision, search: SetSearch, members: Set) -> Decision:
    """The decision with ties of named effects that another effect replaces without loss, whatever its number of parameters.

    Fewer parameters are a reason to prefer a model, not a measurement: poses that do not separate a zero offset from a tilt of
    the base determine their sum only.
    """
    labels = {c.label: k for k, c in enumerate(search.candidates)}
    tied, named = list(decision.tied), []
    for candidate in decision.named:
        if others := list(_replacing(search, members, labels[candidate.label])):
            tied.append((candidate, *(search.candidates[k] for k in others)))
        else:
            named.append(candidate)
    return replace(decision, named=tuple(named), tied=tuple(tied))


def _replacing(search: SetSearch, members: Set, own: int) -> Iterator[int]:
    """Effects that fit as well in the place of one of a set, by less than ``LEAST`` nats, within their bounds."""
    fit = search.posterior(members).fit
    for k, candidate in enumerate(search.candidates):
        if k in members or candidate.contains(search.candidates[own]):  # a special case is preferred to the general effect
            continue
        instead = search.posterior((members - {own}) | {k})
        if instead.inside and instead.fit > fit - LEAST:
            yield k
