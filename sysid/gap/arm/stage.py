"""The links of an arm, from whole-arm motion to a decision: payload and masses of links, beside small errors of every link.

Every link is a little off from its URDF; the sizes of these errors, one for each kind, are estimated from the data, about the
five percent to which masses are usually known. A payload or a wrong mass is named only beside them. The errors themselves are
adjusted in the plant and never named: torques determine combinations of them only (base parameters).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.effects import inertial_error
from sysid.gap.arm.friction import FRICTION, without
from sysid.gap.arm.rows import AxisRows, axis_rows, inefficiency
from sysid.gap.arm.unknowns import (
    KINDS,
    LinkErrors,
    change_of,
    columns_of,
    from_linear,
    linear_width,
    link_errors,
    places,
    slope_of,
    to_linear,
)
from sysid.gap.candidates import Candidate
from sysid.gap.decision import LEAST, Decision, decide
from sysid.gap.fit import place
from sysid.gap.likelihood.explained import Explained
from sysid.gap.likelihood.stage import ModelFit, Prior, block_densities, prior_of
from sysid.gap.poses.regression import PoseRegression, Sizes
from sysid.gap.poses.search import Set, SetSearch
from sysid.gap.problem import Problem
from sysid.gap.stage_model import StageFit
from sysid.machine.rigid_body import PARAMETERS
from sysid.plant import Model
from sysid.plant.layout import AT, AXIS_WIDTH

Array = npt.NDArray[np.float64]

#: Typical relative error of a link's inertial parameters, and spread of its natural logarithm: masses from CAD are known to
#: about five percent.
EXPECTED, SPREAD = 0.05, 0.7
#: Rounds of search and estimation of the sizes.
ROUNDS = 4
#: Further models beside those without an effect.
NEIGHBOURS = 20


def fit_links_stage(
    model: Model,
    problem: Problem,
    recordings: Sequence[Recording],
    theta: Array,
    sigma: Array,
    candidates: Sequence[Candidate],
    nameable: Sequence[str],
    on_fit: Callable[[str], None],
) -> StageFit:
    """Search and decide the links; arguments as of :func:`sysid.gap.stage_model.fit_stage`."""
    there = [c for c in candidates if c.label in nameable]
    whole = _Whole(model, axis_rows(model, problem, recordings, theta), theta, sigma, there)
    search, best = whole.converged(on_fit)
    return _decided(whole, search, best, nameable)


@dataclass(frozen=True)
class _Stack:
    """Rows of all axes, friction projected out, weighted: ``target`` (rows,), ``effects`` (rows, K), ``errors`` (rows, p)."""

    target: Array
    effects: Array
    errors: Array
    block: npt.NDArray[np.int64]
    independent: float

    @property
    def blocks(self) -> int:
        return int(self.block.max(initial=0)) + 1


class _Whole:
    """The regression of a whole arm."""

    def __init__(
        self, model: Model, rows: Sequence[AxisRows], theta: Array, sigma: Array, candidates: Sequence[Candidate]
    ) -> None:
        self.model, self.rows, self.theta, self.sigma = model, rows, theta, sigma
        self.candidates = tuple(candidates)
        self.unknowns = tuple(u for c in candidates for u in c.unknowns)
        self.places = places(candidates)
        self.errors: LinkErrors = link_errors(model, theta)
        self.changes = np.concatenate(
            [np.zeros((0, *self.errors.change.shape[1:])), *(change_of(model, theta, c) for c in candidates)]
        )
        self.nominal = self._linear([np.array([u.nominal for u in c.unknowns]) for c in candidates])
        self.weights = 1.0 / sigma
        self.independent = np.array([float(len(axis.target)) for axis in rows])
        self._weigh()
        self.stack = self._stacked(self.weights)

    def _linear(self, values: Sequence[Array]) -> Array:
        return np.concatenate([np.empty(0), *(to_linear(c, v) for c, v in zip(self.candidates, values, strict=True))])

    @property
    def prior(self) -> Prior:
        """Of the linear coordinates of all candidates."""
        own = prior_of(self.candidates)
        width = np.concatenate(
            [np.empty(0), *(linear_width(c, own.width[at]) for c, at in zip(self.candidates, self.places, strict=True))]
        )
        return Prior(self.nominal, width, own.low, own.high, np.minimum(own.finest, width))

    def _projected(self, axis: AxisRows, weight: float) -> Array:
        """Target, effects and errors of an axis without what its friction explains, weighted, (m, 1 + K + p)."""
        table = np.column_stack([axis.target, columns_of(axis.links, self.changes), columns_of(axis.links, self.errors.change)])
        return weight * without(table, axis.friction)

    def _stacked(self, weights: Array) -> _Stack:
        parts = [self._projected(axis, float(w)) for axis, w in zip(self.rows, weights, strict=True)]
        whole, k = np.concatenate(parts), len(self.unknowns)
        block = np.concatenate([axis.block for axis in self.rows])
        independent = max(float(self.independent.sum()) - FRICTION * len(self.rows), 1.0)
        return _Stack(whole[:, 0], whole[:, 1 : 1 + k], whole[:, 1 + k :], block, independent)

    def _weigh(self) -> None:
        """Weights by the error of each axis beside all effects and errors, its rows counted by their inefficiency."""
        for _ in range(3):
            stack = self._stacked(self.weights)
            columns = np.hstack([stack.effects * self.prior.width, stack.errors * EXPECTED])
            left = stack.target - columns @ np.linalg.solve(
                columns.T @ columns + np.eye(columns.shape[1]), columns.T @ stack.target
            )
            ends = np.cumsum([0, *(len(axis.target) for axis in self.rows)])
            for j, axis in enumerate(self.rows):
                own = left[ends[j] : ends[j + 1]] / self.weights[j]
                rms = max(float(np.sqrt(np.mean(own**2))), float(self.sigma[j]))
                factor = inefficiency(own)
                self.weights[j] = 1.0 / (rms * np.sqrt(factor))
                self.independent[j] = len(axis.target) / factor

    def search(self, sizes: Sizes) -> SetSearch:
        stack = self.stack
        regression = PoseRegression(
            stack.target, stack.effects, stack.errors, self.errors.kind, self.prior, self.nominal,
            round(stack.independent), sizes, EXPECTED, SPREAD,
        )  # fmt: skip
        return SetSearch(regression, self.candidates, self.places)

    def converged(self, on_fit: Callable[[str], None]) -> tuple[SetSearch, Set]:
        """Set of effects and sizes of the errors that stay when each is renewed beside the other."""
        search = self.search(Sizes(np.full(len(KINDS), EXPECTED), 1.0))
        best: Set = frozenset()
        for _ in range(ROUNDS):
            found = max((search.likeliest(start) for start in {best, frozenset[int]()}), key=search.evidence)
            on_fit(", ".join(sorted(self.candidates[k].label for k in found)) or "nominal")
            search, same = self.search(search.regression.with_sizes(search.unknowns(found))), found == best
            best = found
            if same:
                break
        return search, best

    def coefficients(self, search: SetSearch, members: Set) -> tuple[Array, Array]:
        """Most likely linear changes of a set (k,), and errors of the links (p,), together."""
        at, sizes = search.unknowns(members), search.regression.sizes
        tau = sizes.tau[self.errors.kind]
        width = self.prior.width[at]
        columns = np.hstack([self.stack.effects[:, at] * width, self.stack.errors * tau]) / sizes.noise
        found = np.linalg.solve(columns.T @ columns + np.eye(columns.shape[1]), columns.T @ self.stack.target / sizes.noise)
        return found[: len(at)] * width, found[len(at) :] * tau

    def model_of(self, search: SetSearch, members: Set) -> ModelFit:
        """A set of effects as a model of the decision; its parameter vector contains the errors of the links too."""
        at, sizes = search.unknowns(members), search.regression.sizes
        posterior = search.posterior(members)
        change, errors = self.coefficients(search, members)
        chosen = [self.candidates[k] for k in sorted(members)]
        unknowns = tuple(u for c in chosen for u in c.unknowns)
        linear = np.clip(self.nominal[at] + change, self.prior.low[at], self.prior.high[at])
        parts = places(chosen)
        values = np.concatenate([np.empty(0), *(from_linear(c, linear[p]) for c, p in zip(chosen, parts, strict=True))])
        slope = np.zeros((len(values), len(values)))
        for c, p in zip(chosen, parts, strict=True):
            slope[np.ix_(p, p)] = slope_of(c, linear[p])
        theta = place(self.theta, unknowns, values[None])[0] if unknowns else self.theta.copy()
        theta = self._with_errors(theta, members, search, change, errors)
        tau = sizes.tau[self.errors.kind]
        effects = self.stack.effects[:, at]
        table = np.hstack([self.stack.errors * tau, effects * self.prior.width[at]]) / sizes.noise
        predictive = block_densities(
            table, self.stack.target / sizes.noise, table.T @ table + np.eye(table.shape[1]), self.stack
        )
        left = self.stack.target - effects @ change - self.stack.errors @ errors
        count = max(self.stack.independent, 1.0)
        response = np.sqrt((effects**2).sum(axis=0) / count)
        inverse = np.linalg.inv(slope) if len(values) else slope
        return ModelFit(
            tuple(chosen), unknowns, values, theta, slope @ posterior.covariance @ slope.T, np.zeros(len(values)),
            posterior.evidence, predictive, float(np.sqrt(left @ left / count)) / sizes.noise,
            np.abs(response @ inverse) if len(values) else response, float(np.sqrt(left @ left / count)),
        )  # fmt: skip

    def _with_errors(self, theta: Array, members: Set, search: SetSearch, change: Array, errors: Array) -> Array:
        """The vector with the errors of the links; inertias of rotors that machine.toml does not state beside them."""
        theta = theta.copy()
        if self.needed(search, members) < LEAST:
            errors = np.zeros_like(errors)
        off = np.tensordot(errors, self.errors.change, axes=1)
        rigid = self.model.rigid
        assert rigid is not None
        for i, body in enumerate(rigid.body_of):
            first = i * AXIS_WIDTH + AT.inertial_error
            theta[first : first + PARAMETERS] += off[body]
        at = search.unknowns(members)
        whole = np.tensordot(change, self.changes[at], axes=1).reshape(-1) + off.reshape(-1)
        for axis in self.rows:
            if self.model.machine.axis(axis.axis).inertia is None:
                left = axis.target - axis.links @ whole
                size = np.maximum(np.linalg.norm(axis.friction, axis=0), 1e-12)
                found = np.linalg.lstsq(axis.friction / size, left, rcond=1e-9)[0] / size
                theta[self.model.axis_index(axis.axis) * AXIS_WIDTH + AT.inertial_error + PARAMETERS] += found[-1]
        return theta

    def needed(self, search: SetSearch, members: Set) -> float:
        """Gain in evidence by errors of the links, with the noise that is most likely without them [nats]."""
        regression, at = search.regression, search.unknowns(members)
        alone = replace(
            regression,
            errors=np.empty((len(regression.target), 0)),
            kind=np.empty(0, dtype=np.int64),
            sizes=Sizes(np.empty(0), regression.sizes.noise),
        )
        alone = replace(alone, sizes=alone.with_sizes(at))
        return search.posterior(members).evidence - alone.posterior(at).evidence


def _decided(whole: _Whole, search: SetSearch, best: Set, nameable: Sequence[str]) -> StageFit:
    @cache
    def model_of(members: Set) -> ModelFit:
        return whole.model_of(search, members)

    def members_of(model: ModelFit) -> Set:
        return frozenset(k for k, c in enumerate(search.candidates) if c.label in model.labels)

    def less(model: ModelFit, candidate: Candidate) -> ModelFit:
        return model_of(frozenset(k for k in members_of(model) if search.candidates[k].label != candidate.label))

    near = sorted((*search.exchanged(best), *search.larger(best)), key=search.evidence, reverse=True)
    near = [s for s in near if np.isfinite(search.evidence(s))][:NEIGHBOURS]
    sets = dict.fromkeys((best, *search.smaller(best), *near, frozenset[int]()))
    decision = decide(
        [model_of(s) for s in sets], nameable, needed=lambda model: 0.0, integrates=False, without=less, independent=True
    )
    decision = _with_ties(decision, search, members_of(decision.model))
    chosen = decision.model
    models = sorted((model_of(s) for s in sets), key=lambda f: -f.evidence)
    dropped = {c.label: _absent(chosen, less(chosen, c), c) for c in chosen.candidates}
    return StageFit(tuple(models), decision, dropped, Explained(chosen.left, chosen.left, {}), chosen)


def _absent(chosen: ModelFit, less: ModelFit, candidate: Candidate) -> ModelFit:
    """The model without an effect, its vector that of the chosen one without it.

    Refitted, the errors of a link would take the place of a payload on it, whatever their size.
    """
    nominal = np.array([[u.nominal for u in candidate.unknowns]])
    return replace(less, theta=place(chosen.theta, candidate.unknowns, nominal)[0])


def _with_ties(decision: Decision, search: SetSearch, members: Set) -> Decision:
    """The decision with ties of named effects that another one replaces without a loss of ``LEAST`` nats."""
    labels = {c.label: k for k, c in enumerate(search.candidates)}
    tied, named = list(decision.tied), []
    for candidate in decision.named:
        others = list(_replacing(search, members, labels[candidate.label]))
        if others:
            tied.append((candidate, *(search.candidates[k] for k in others)))
        else:
            named.append(candidate)
    return replace(decision, named=tuple(named), tied=tuple(tied))


def _replacing(search: SetSearch, members: Set, own: int) -> Iterator[int]:
    fit = search.posterior(members).fit
    for k in range(len(search.candidates)):
        if k not in members:
            instead = search.posterior((members - {own}) | {k})
            if instead.inside and instead.fit > fit - LEAST:
                yield k


def links_adjusted(model: Model, theta: Array, before: Array) -> list[str]:
    """Axes whose links' inertial parameters differ between two vectors."""
    width = len(inertial_error.EFFECT.slots)
    firsts = {name: i * AXIS_WIDTH + AT.inertial_error for i, name in enumerate(model.machine.axis_names)}
    return [name for name, at in firsts.items() if not np.array_equal(theta[at : at + width], before[at : at + width])]
