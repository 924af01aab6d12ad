"""The end-effector stage of a pose set, from its poses to a decision: linearise → sizes → sets of effects → decision.

Geometry, sensors, compliance and the frame of the measurement are in one search from the start: calibrated one after the other,
the first would absorb what the others cause. The tip is a smooth function of all unknowns, so the search runs in the linearised
model, which is renewed at the values of the set found until both stay.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.effects import base_misalignment, tip_offset
from sysid.gap.candidates import Candidate
from sysid.gap.decision import Decision, decide
from sysid.gap.fit import place
from sysid.gap.likelihood.explained import Explained
from sysid.gap.likelihood.gaussian_regression import NOISE_SPREAD, GaussianRegression, Sizes
from sysid.gap.likelihood.stage import ModelFit, prior_of
from sysid.gap.poses.combinations import undetermined
from sysid.gap.poses.models import as_model
from sysid.gap.poses.registration import registered
from sysid.gap.poses.rows import PoseRows, weights_of
from sysid.gap.poses.search import Set, SetSearch
from sysid.gap.problem import Problem
from sysid.gap.stage_model import StageFit
from sysid.gap.thresholds import LEAST
from sysid.plant import Model

Array = npt.NDArray[np.float64]

#: Effects of the measurement, with which every search begins: its frame, and the measured point where it is not surveyed.
MEASUREMENT = (base_misalignment.EFFECT, tip_offset.EFFECT)
#: Rounds of search and linearisation.
ROUNDS = 6
#: Further models beside those without an effect: exchanges and additions, the likeliest.
NEIGHBOURS = 40


def fit_pose_stage(
    model: Model,
    problem: Problem,
    recordings: Sequence[Recording],
    theta: Array,
    sigma: Array,
    candidates: Sequence[Candidate],
    nameable: Sequence[str],
    on_fit: Callable[[str], None],
) -> StageFit:
    """Search and decide the end-effector stage of static poses; arguments as of :func:`sysid.gap.stage_model.fit_stage`.

    Effects that the poses do not excite are left out: they would absorb the errors of others. The frame of the measurement
    stays, whether the poses determine it or not.
    """
    rows = PoseRows(model, problem, recordings, theta, sigma)
    there = [c for c in candidates if c.label in nameable or c.effect in MEASUREMENT]
    fitting = _Fitting(rows, there)
    search, best = fitting.converged(on_fit)
    fitting.weights = weights_of(rows, fitting.residual(search, best))
    search, best = fitting.converged(on_fit, best)
    return _decided(fitting, search, best, nameable)


class _Fitting:
    """The regression of a pose set at the current linearisation, sizes and weights."""

    def __init__(self, rows: PoseRows, candidates: Sequence[Candidate]) -> None:
        self.rows, self.candidates = rows, tuple(candidates)
        self.unknowns = tuple(u for c in candidates for u in c.unknowns)
        ends = np.cumsum([0, *(len(c.unknowns) for c in candidates)])
        self.places = [np.arange(a, b, dtype=np.intp) for a, b in pairwise(ends)]
        self.prior = prior_of(self.candidates)
        self.nominal = np.array([u.nominal for u in self.unknowns])
        self.values = self._registered()
        self.weights = np.ones(rows.poses)
        self.sizes: Sizes | None = None

    def _registered(self) -> Array:
        """Nominal values, with those of the measurement fitted to the described geometry."""
        frame = [int(k) for c in sorted(self.base) for k in self.places[c]]
        values = self.nominal.copy()
        if frame:
            values[frame] = registered(self.rows, [self.unknowns[k] for k in frame], self.nominal[frame])
        return np.asarray(np.clip(values, self.prior.low, self.prior.high))

    @property
    def base(self) -> Set:
        """The effects of :data:`MEASUREMENT`, with which every search begins."""
        return frozenset(k for k, c in enumerate(self.candidates) if c.effect in MEASUREMENT)

    @property
    def base_labels(self) -> frozenset[str]:
        return frozenset(self.candidates[k].label for k in self.base)

    def search(self) -> SetSearch:
        """The regression linearised at the current values, under the current sizes."""
        whole = place(self.rows.theta, self.unknowns, self.values[None])[0] if self.unknowns else self.rows.theta
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
        return SetSearch(found, self.candidates, self.places)

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
        at = search.unknowns(members)
        weights = np.maximum(self.rows.by_row(self.weights), 1e-9)
        regression = search.regression
        return np.asarray((regression.target - regression.columns[:, at] @ search.posterior(members).change) / weights)


def _decided(fitting: _Fitting, search: SetSearch, best: Set, nameable: Sequence[str]) -> StageFit:
    regression = search.regression
    bare = replace(regression, errors=np.empty((len(regression.target), 0)), kind=np.empty(0, dtype=np.int64))

    @cache
    def model_of(members: Set) -> ModelFit:
        return as_model(fitting.rows, search, members, fitting.weights)

    def members_of(model: ModelFit) -> Set:
        labels = model.labels
        return frozenset(k for k, c in enumerate(search.candidates) if c.label in labels)

    @cache
    def needed(model: ModelFit) -> float:
        """Gain in evidence by the errors of the arm, with the noise that is most likely without them.

        Poses that scatter by more than their noise can are wrong by something else, whether these errors describe it or not.
        """
        if regression.sizes.noise > np.exp(2.0 * NOISE_SPREAD):
            return float(np.inf)
        at = search.unknowns(members_of(model))
        alone = replace(bare, sizes=Sizes(np.empty(0), regression.sizes.noise))
        alone = alone.under(alone.with_sizes(at))
        return search.posterior(members_of(model)).evidence - alone.posterior(at).evidence

    def without(model: ModelFit, candidate: Candidate) -> ModelFit:
        return model_of(frozenset(k for k in members_of(model) if search.candidates[k].label != candidate.label))

    # A larger set that is clearly less likely cannot be preferred: its further effect is not a near miss.
    richer = [s for s in search.larger(best) if search.evidence(s) > search.evidence(best) - LEAST]
    near = sorted((*search.exchanged(best), *richer), key=search.evidence, reverse=True)
    near = [s for s in near if np.isfinite(search.evidence(s))][:NEIGHBOURS]
    sets = dict.fromkeys((best, *search.smaller(best), *near, fitting.base, frozenset()))

    def decided() -> Decision:
        models = [model_of(s) for s in sets]
        return decide(
            models, nameable, needed=needed, integrates=False, without=without, independent=True, first=fitting.base_labels
        )

    decision = decided()
    for _ in range(4):
        more = [s for f in (decision.model, *decision.acceptable) for s in search.smaller(members_of(f)) if s not in sets]
        if not more:
            break
        sets |= dict.fromkeys(more)
        decision = decided()
    decision = _with_confounded(decision, search, members_of(decision.model))
    chosen = decision.model
    models = sorted((model_of(s) for s in sets), key=lambda f: -f.evidence)
    dropped = {c.label: without(chosen, c) for c in chosen.candidates}
    remainder = Explained(chosen.left, float(regression.sizes.noise), {})
    return StageFit(
        tuple(models),
        decision,
        dropped,
        remainder,
        chosen,
        combinations=tuple(undetermined(search)),
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
        own = labels[candidate.label]
        others = list(_replacing(search, members, own))
        if others:
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
