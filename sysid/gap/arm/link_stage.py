"""The links of an arm, from whole-arm motion to a decision: payload and masses of links, beside small errors of all the rest.

Every link is a little off from its URDF, and so is the constant from which the force of an axis was computed. The sizes of
these errors, one for each kind, are estimated for every set of effects, about the five percent to which they are usually known:
an effect is named where its evidence is very strong against a model in which the small errors are as large as need be. The
errors themselves are adjusted in the plant and never named, since torques determine combinations of them only (base
parameters).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
import numpy.typing as npt

from sysid.effects import inertial_error
from sysid.gap.arm.effect_sets import GAIN, Index, Set, densities_of_blocks, gain_of_errors, places, unknowns_of
from sysid.gap.arm.forces import CONSTANT, FRICTION, fitted, without
from sysid.gap.arm.link_rows import (
    FORCE_CONSTANT,
    ROTOR,
    AxisRows,
    axis_rows,
    change_of,
    columns_of,
    doubled,
    from_linear,
    inefficiency,
    linearised,
    link_errors,
    plausible,
    to_linear,
    with_carried,
)
from sysid.gap.candidates import Candidate
from sysid.gap.data import SearchInput
from sysid.gap.decision import Decision, NearMiss
from sysid.gap.fit import place
from sysid.gap.likelihood.explained import Explained
from sysid.gap.likelihood.gaussian_regression import GaussianRegression, Posterior, Sizes
from sysid.gap.likelihood.stage import ModelFit, Prior, prior_of
from sysid.gap.reasons import Reason
from sysid.gap.stage_model import StageFit
from sysid.gap.thresholds import BLOCK_NATS, LEAST
from sysid.machine.rigid_body import PARAMETERS
from sysid.plant import Model
from sysid.plant.layout import AT, AXIS_WIDTH

Array = npt.NDArray[np.float64]

#: Typical relative errors of each kind, and spread of their natural logarithm: masses are weighed or computed from CAD to
#: about five percent; inertias are often those of a simpler solid, and the constant between current and torque includes the
#: efficiency of a gear.
EXPECTED, SPREAD = np.array([0.05, 0.05, 0.1, 0.1, 0.1, 0.1]), np.array([0.7, 0.7, 0.7, 0.7, 0.7, 2.3])
#: Searches at most with the friction of the torques found.
ROUNDS = 3
#: Regressions at most about the result of the last one, and change of the torques [share] that ends them: with force constants
#: a tenth off, a hundredth changes their product by a thousandth.
STEPS, SETTLED = 8, 0.01


def fit_links_stage(given: SearchInput) -> StageFit:
    """Search and decide the links."""
    model, seen, theta = given.model, given.seen, given.theta
    there = [c for c in given.candidates if c.label in given.nameable]
    rows = axis_rows(model, seen.problem, seen.recordings, theta)
    whole = _Whole(model, rows, theta, seen.sigma, there)
    best = _likeliest(whole, given.on_fit)
    for _ in range(ROUNDS if best else 0):  # a payload that is found loads the joints, and with them their friction
        rows = with_carried(rows, model, seen.problem, seen.recordings, whole.model_of(best).theta)
        before, whole = best, _Whole(model, rows, theta, seen.sigma, there)
        best = _likeliest(whole, given.on_fit)
        if best == before:
            break
    return _decided(whole, best)


def _with_products(whole: _Whole, members: Set) -> ModelFit:
    """A set of effects with the products of force constants and links, which the regression about the plant under test lacks.

    Repeated regressions about the vector found before (Gauss and Newton); the first one's result where they do not settle.
    Sets are compared without the products: a constant would carry the torque of a payload that only another set contains.
    """
    first = found = whole.model_of(members)
    rows = whole.rows
    for _ in range(STEPS):
        before, rows = rows, linearised(whole.rows, whole.model, whole.theta, found.theta)
        if _settled(before, rows):
            return replace(found, evidence=first.evidence)
        found = whole.about(rows, members).model_of(members)
    return first


def _settled(before: Sequence[AxisRows], rows: Sequence[AxisRows]) -> bool:
    """Whether the torque of the links about which the rows are linearised hardly differs on any axis."""
    pairs = zip(before, rows, strict=True)
    return all(np.linalg.norm(own.carried - old.carried) <= SETTLED * np.linalg.norm(own.carried) for old, own in pairs)


class _Whole:
    """The regression of a whole arm on the linear coordinates of all candidates."""

    def __init__(
        self, model: Model, rows: Sequence[AxisRows], theta: Array, sigma: Array, candidates: Sequence[Candidate]
    ) -> None:
        self.model, self.rows, self.theta, self.sigma = model, rows, theta, sigma
        self.candidates = tuple(candidates)
        self.places = places(candidates)
        self.link_errors, kind = link_errors(model, theta)
        self.kind = np.concatenate([kind, np.repeat([FORCE_CONSTANT, ROTOR], len(rows))])
        self.changes = np.concatenate([self.link_errors[:0], *(change_of(model, c) for c in candidates)])
        self.nominal = self._linear([np.array([u.nominal for u in c.unknowns]) for c in candidates])
        own = prior_of(self.candidates)
        width = self._linear([own.width[at] for at in self.places])
        self.prior = Prior(self.nominal, width, own.low, own.high, np.minimum(own.finest, width))
        self.weights = 1.0 / sigma
        counts = self._weigh()
        self.count = max(float(counts.sum()) - FRICTION * len(rows), 1.0)
        target, effects, errors = self._stacked()
        self.regression = GaussianRegression(
            target,
            effects,
            errors,
            self.kind,
            self.prior,
            self.nominal,
            round(self.count),
            Sizes(EXPECTED, 1.0),
            EXPECTED,
            SPREAD,
        )
        self._sizes: dict[Set, Sizes] = {}
        self._posteriors: dict[Set, Posterior] = {}

    def about(self, rows: Sequence[AxisRows], members: Set) -> _Whole:
        """The regression on rows that are linearised about another vector, with the sizes of a set as they are."""
        other = _Whole(self.model, rows, self.theta, self.sigma, self.candidates)
        other._sizes[members] = self.sizes(members)
        return other

    def _linear(self, values: Sequence[Array]) -> Array:
        """Linear coordinates (K,) of values of each candidate."""
        return np.concatenate([np.empty(0), *(to_linear(c, v) for c, v in zip(self.candidates, values, strict=True))])

    def _of_errors(self, axis: AxisRows) -> Array:
        """Slopes of the force of an axis by all small errors, with its friction, (m, p)."""
        constants, rotors = np.zeros((2, len(axis.target), len(self.rows)))
        here = [own.axis for own in self.rows].index(axis.axis)
        constants[:, here], rotors[:, here] = axis.carried, axis.rotor
        return np.column_stack([columns_of(axis.links, self.link_errors), constants, rotors])

    def _stacked(self) -> tuple[Array, Array, Array]:
        """Rows of all axes, friction projected out, weighted: target (rows,), candidates (rows, K), small errors (rows, p)."""
        parts = []
        for axis, weight in zip(self.rows, self.weights, strict=True):
            table = np.column_stack([axis.target, columns_of(axis.links, self.changes), self._of_errors(axis)])
            parts.append(float(weight) * without(table, axis.friction))
        whole, first = np.concatenate(parts), 1 + len(self.nominal)
        return whole[:, 0], whole[:, 1:first], whole[:, first:]

    def _weigh(self) -> Array:
        """Weights by the error of each axis beside all effects and errors; its number of independent rows, (axes,)."""
        independent = np.empty(len(self.rows))
        ends = np.cumsum([0, *(len(axis.target) for axis in self.rows)])
        for _ in range(3):
            target, effects, errors = self._stacked()
            columns = np.hstack([effects * self.prior.width, errors * EXPECTED[self.kind]])
            left = target - columns @ np.linalg.solve(columns.T @ columns + np.eye(columns.shape[1]), columns.T @ target)
            for j, axis in enumerate(self.rows):
                here = slice(ends[j], ends[j + 1])
                own = left[here] / self.weights[j]
                rms = max(float(np.sqrt(np.mean(own**2))), float(self.sigma[j]))
                factor = inefficiency(own, np.hstack([effects[here], errors[here]]), axis.block)
                self.weights[j] = 1.0 / (rms * np.sqrt(factor))
                independent[j] = len(axis.target) / factor
        return independent

    def unknowns_of(self, members: Set) -> Index:
        """Indices of the linear coordinates of a set."""
        return unknowns_of(self.places, members)

    def under(self, members: Set) -> GaussianRegression:
        """The regression under the sizes that are most likely beside a set."""
        return self.regression.under(self.sizes(members))

    def sizes(self, members: Set) -> Sizes:
        """Most likely sizes of the small errors beside a set of effects."""
        if members not in self._sizes:
            self._sizes[members] = self.regression.with_sizes(self.unknowns_of(members))
        return self._sizes[members]

    def posterior(self, members: Set) -> Posterior:
        if members not in self._posteriors:
            self._posteriors[members] = self.under(members).posterior(self.unknowns_of(members))
        return self._posteriors[members]

    def evidence(self, members: Set) -> float:
        """Of a set with the sizes that are most likely beside it; minus infinity where a value leaves its bounds."""
        found, sizes = self.posterior(members), self.sizes(members)
        away = (np.log(sizes.tau) - np.log(EXPECTED)) / SPREAD
        linear = self.nominal[self.unknowns_of(members)] + found.change
        deviations = np.sqrt(np.diag(found.covariance))
        chosen = [self.candidates[k] for k in sorted(members)]
        sound = all(plausible(c, linear[p], deviations[p]) for c, p in zip(chosen, places(chosen), strict=True))
        sound = sound and not doubled(self.model, chosen)
        return found.evidence - 0.5 * float(away @ away) if found.inside and sound else -np.inf

    def coefficients(self, members: Set) -> tuple[Array, Array]:
        """Most likely linear changes of a set (k,), and small errors (p,), together."""
        columns, scale = self._scaled(members)
        noise, count = self.sizes(members).noise, len(self.unknowns_of(members))
        found = scale * np.linalg.solve(
            columns.T @ columns + np.eye(columns.shape[1]), columns.T @ self.regression.target / noise
        )
        return found[:count], found[count:]

    def _scaled(self, members: Set) -> tuple[Array, Array]:
        """Columns of a set and of all small errors with prior and noise of unit size, and the size of each."""
        at, sizes = self.unknowns_of(members), self.sizes(members)
        scale = np.concatenate([self.prior.width[at], sizes.tau[self.kind]])
        return np.hstack([self.regression.columns[:, at], self.regression.errors]) * scale / sizes.noise, scale

    def open_loads(self, members: Set) -> dict[str, float]:
        """Standard deviation of the constant load on each axis that the adjusted links may have instead [N·m or N].

        A constant is left out of the regression as friction is: what the postures of the recordings do not distinguish from
        it, a first moment of a link may be. Empty where the links are not adjusted.
        """
        if self.needed(members) < LEAST:
            return {}
        columns, scale = self._scaled(members)
        spread = np.linalg.inv(columns.T @ columns + np.eye(columns.shape[1])) * np.outer(scale, scale)
        first = len(self.unknowns_of(members))
        spread, found = spread[first:, first:], {}
        for axis in self.rows:
            constant = axis.friction[:, CONSTANT]
            share = constant @ self._of_errors(axis) / max(float(constant @ constant), 1e-300)
            found[axis.axis] = float(np.sqrt(share @ spread @ share))
        return found

    def model_of(self, members: Set) -> ModelFit:
        """A set of effects as a model of the decision; its parameter vector contains the small errors too."""
        at, sizes = self.unknowns_of(members), self.sizes(members)
        posterior = self.posterior(members)
        change, errors = self.coefficients(members)
        chosen = [self.candidates[k] for k in sorted(members)]
        unknowns = tuple(u for c in chosen for u in c.unknowns)
        linear = np.clip(self.nominal[at] + change, self.prior.low[at], self.prior.high[at])
        values, slope = np.empty(len(at)), np.zeros((len(at), len(at)))
        for candidate, here in zip(chosen, places(chosen), strict=True):
            values[here], slope[np.ix_(here, here)] = from_linear(candidate, linear[here])
        effects, block = self.regression.columns[:, at], np.concatenate([axis.block for axis in self.rows])
        residual = self.regression.target - effects @ change - self.regression.errors @ errors
        left = float(np.sqrt(residual @ residual / self.count))
        return ModelFit(
            candidates=tuple(chosen),
            unknowns=unknowns,
            values=values,
            theta=self._with_errors(place(self.theta, unknowns, values[None])[0], members, change, errors),
            covariance=slope @ posterior.covariance @ slope.T,
            confounded=np.zeros(len(at)),
            evidence=self.evidence(members),
            predictive=densities_of_blocks(self.under(members), at, block, int(block.max(initial=0)) + 1),
            rms=left / sizes.noise,
            response=np.abs(np.sqrt((effects**2).sum(axis=0) / self.count) @ np.linalg.inv(slope)),
            left=left,
        )

    def _with_errors(self, theta: Array, members: Set, change: Array, errors: Array) -> Array:
        """The vector with the errors of the links; inertias of rotors that machine.toml does not state beside them."""
        theta = theta.copy()
        if self.needed(members) < LEAST:
            errors = np.zeros_like(errors)
        off = np.tensordot(errors[: len(self.link_errors)], self.link_errors, axes=1)
        rigid = self.model.rigid
        assert rigid is not None
        for i, body in enumerate(rigid.body_of):
            first = i * AXIS_WIDTH + AT.inertial_error
            theta[first : first + PARAMETERS] += off[body]
        whole = np.tensordot(change, self.changes[self.unknowns_of(members)], axes=1).reshape(-1) + off.reshape(-1)
        scales, rotors = errors[len(self.link_errors) :].reshape(2, -1)
        for axis, scale, rotor in zip(self.rows, scales, rotors, strict=True):
            block = self.model.axis_index(axis.axis) * AXIS_WIDTH
            first, stated = block + AT.inertial_error + PARAMETERS, self.model.machine.axis(axis.axis).inertia
            theta[first + 1] *= 1.0 + scale
            theta[first] += rotor * (stated or 0.0) * theta[block + AT.inertia_error]
            if stated is None:
                left = axis.target - axis.links @ whole - scale * axis.carried
                theta[first] += fitted(axis.friction, left)[0][-1]
        return theta

    def needed(self, members: Set) -> float:
        """Gain in evidence by the small errors [nats]."""
        return gain_of_errors(self.under(members), self.unknowns_of(members))


def _likeliest(whole: _Whole, on_fit: Callable[[str], None]) -> Set:
    """The smallest set to which no further effect adds very strong evidence; effects are added and exchanged one by one."""
    best: Set = frozenset()
    while True:
        on_fit(", ".join(sorted(whole.candidates[k].label for k in best)) or "nominal")
        more = max((best | {k} for k in range(len(whole.candidates)) if k not in best), key=whole.evidence, default=best)
        if whole.evidence(more) <= whole.evidence(best) + BLOCK_NATS:
            return best
        best = more
        while (other := max(_exchanged(whole, best), key=whole.evidence, default=best)) != best:
            if whole.evidence(other) <= whole.evidence(best) + GAIN:
                break
            best = other


def _exchanged(whole: _Whole, members: Set) -> list[Set]:
    """One effect in the place of another."""
    others = [k for k in range(len(whole.candidates)) if k not in members]
    return [members - {own} | {k} for own in sorted(members) for k in others]


def _decided(whole: _Whole, best: Set) -> StageFit:
    """The effects of a set, those as ties that another one replaces with less than strong evidence against it."""
    model_of = cache(partial(_with_products, whole))
    chosen = model_of(best)
    named, tied = list[Candidate](), list[tuple[Candidate, ...]]()
    others = [k for k in range(len(whole.candidates)) if k not in best]
    for own in sorted(best):
        instead = [k for k in others if whole.evidence(best - {own} | {k}) > whole.evidence(best) - LEAST]
        candidate = whole.candidates[own]
        if instead:
            tied.append((candidate, *(whole.candidates[k] for k in instead)))
        else:
            named.append(candidate)
    further = sorted((best | {k} for k in others), key=whole.evidence, reverse=True)
    further = [s for s in further if whole.evidence(s) > whole.evidence(best)]
    near = []
    for members in further:
        richer = model_of(members)
        candidate = next(whole.candidates[k] for k in members - best)
        near.append(NearMiss(candidate, richer.values_of(candidate), richer.deviations_of(candidate), Reason.LINKS))
    models = [model_of(s) for s in dict.fromkeys((best, *(best - {k} for k in sorted(best)), *further))]
    decision = Decision(chosen, tuple(named), tuple(tied), tuple(near), (chosen,), (chosen,), exact=True, accumulates=False)
    dropped = {c.label: _absent(chosen, model_of(best - {k}), c) for k, c in enumerate(whole.candidates) if k in best}
    models.sort(key=lambda f: -f.evidence)
    explained = Explained(chosen.left, chosen.left, {})
    return StageFit(tuple(models), decision, dropped, explained, chosen, open_loads=whole.open_loads(best))


def _absent(chosen: ModelFit, less: ModelFit, candidate: Candidate) -> ModelFit:
    """The model without an effect, its vector that of the chosen one without it.

    Refitted, the errors of a link would take the place of a payload on it, whatever their size.
    """
    nominal = np.array([[u.nominal for u in candidate.unknowns]])
    return replace(less, theta=place(chosen.theta, candidate.unknowns, nominal)[0])


def links_adjusted(model: Model, theta: Array, before: Array) -> list[str]:
    """Axes whose links' inertial parameters differ between two vectors."""
    width = len(inertial_error.EFFECT.slots)
    firsts = {name: i * AXIS_WIDTH + AT.inertial_error for i, name in enumerate(model.machine.axis_names)}
    return [name for name, at in firsts.items() if not np.array_equal(theta[at : at + width], before[at : at + width])]
