"""Formula of a residual: a few physical terms and periods, found by sparse regression, validated on recordings left out.

A term is a product of factors of measured variables (``load of boom``, ``|speed of boom|``, ``sin(2π·boom.cylinder/P)``).
Terms are screened by the path of the lasso (least angle regression, Efron et al. 2004; scikit-learn), periods come from a
periodogram (:mod:`sysid.gap.unnamed.periodic`) of the same columns, sine and cosine as one group; the number of groups is
chosen by cross-validation over blocks, within one standard error of the best. The whole search is repeated without each
recording in turn, so that the explained share of variance is that of recordings unknown to the search.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise

import numpy as np
import numpy.typing as npt

from sysid.gap.unnamed.periodic import Frequencies, Periodogram, best_period, searched
from sysid.gap.unnamed.residual_series import (
    Factor,
    ResidualSeries,
    Term,
    lag1_autocorrelation,
    modulations,
    quasi_difference,
    ripple,
    share_explained,
    shared_variables,
)

Array = npt.NDArray[np.float64]
#: Columns of terms that enter a formula together.
Group = tuple[int, ...]

#: Largest number of groups of terms in a formula.
MAX_GROUPS = 4
#: Least number of blocks into which recordings are cut, and least length of a block [entries].
MIN_BLOCKS, MIN_BLOCK_LENGTH = 6, 60
#: Largest number of searches without a part of the recordings; fewer recordings than the least are cut into blocks, whose ends
#: are cut off as a guard [s].
MAX_FOLDS, MIN_RECORDINGS, GUARD = 6, 3, 2.0
#: Steps of the lasso path whose terms are tested.
PATH_STEPS = 12
#: Groups of terms that explain less than this share of the variance are dropped.
MIN_SHARE = 0.01


@dataclass(frozen=True)
class Formula:
    """A sum of terms and a constant.

    Args:
        coefficients: one for each of ``terms``.
    """

    terms: tuple[Term, ...] = ()
    coefficients: tuple[float, ...] = ()
    constant: float = 0.0

    def predict(self, series: ResidualSeries) -> Array:
        """Target of the series, (m,)."""
        out = np.full(len(series.target), self.constant)
        for coefficient, term in zip(self.coefficients, self.terms, strict=True):
            out += coefficient * term.column(series)
        return out

    def residual(self, series: ResidualSeries) -> Array:
        """What it leaves of the target, (m,)."""
        return series.target - self.predict(series)

    @property
    def variables(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(variable for term in self.terms for variable in term.variables))

    @property
    def periodic(self) -> Factor | None:
        """The first sine or cosine; None where no term is periodic."""
        return next((term.periodic for term in self.terms if term.periodic is not None), None)

    def __str__(self) -> str:
        out = ""
        pairs = zip(self.terms, self.coefficients, strict=True)
        for _, members in groupby(pairs, key=lambda pair: pair[0].group):
            value, text = _written(list(members))
            sign = ("−" if value < 0.0 else "") if not out else (" − " if value < 0.0 else " + ")
            out += f"{sign}{abs(value):.3g}·{text}"
        return out


def _written(group: Sequence[tuple[Term, float]]) -> tuple[float, str]:
    """Coefficient and text of a group of terms; sine and cosine of a ripple become one sine with a phase."""
    term, coefficient = group[0]
    wave = term.periodic
    if wave is None:
        return coefficient, str(term)
    sizes = {each.periodic.function: value for each, value in group if each.periodic is not None}
    sine, cosine = sizes.get("sin", 0.0), sizes.get("cos", 0.0)
    phase = np.arctan2(cosine, sine)
    text = f"sin(2π·{wave.variable}/{wave.number:.4g} {'+' if phase >= 0.0 else '−'} {abs(phase):.2f})"
    return float(np.hypot(sine, cosine)), "·".join([text, *(str(f) for f in term.factors if f is not wave)])


@dataclass(frozen=True)
class ValidatedFormula:
    """A formula, and how well it predicts recordings left out of the search.

    Args:
        share: of the prewhitened variance of recordings that the search did not see.
        p_value: of the hypothesis that it does not predict them better than a constant.
        ar1: lag-1 autocorrelation of the residual after the formula.
    """

    formula: Formula
    share: float
    p_value: float
    ar1: float


def find_formula(series: Sequence[ResidualSeries], periodic_over: Iterable[str]) -> ValidatedFormula:
    """The formula of a residual, and its explained share on recordings left out of the search.

    Args:
        periodic_over: variables over which the residual may be periodic.
    """
    names = shared_variables(series)
    series = [replace(part, variables={name: part.variables[name] for name in names}) for part in series]
    periodic_over = [name for name in periodic_over if name in names]
    ar1 = lag1_autocorrelation([part.target for part in series])
    formula = _search(series, ar1, periodic_over)
    left = lag1_autocorrelation([formula.residual(part) for part in series])
    if left < ar1 - 0.05:  # the explained part was autocorrelated itself
        ar1 = left
        formula = _search(series, ar1, periodic_over)
    before, after = [], []
    for inside, outside in _folds(series):
        found = _search(inside, ar1, periodic_over)
        mean = np.nanmean(np.concatenate([part.target for part in inside]))
        for part in outside:
            rest = quasi_difference(found.residual(part), ar1)
            plain = quasi_difference(part.target - mean, ar1)
            there = np.isfinite(rest)
            before.append(plain[there] ** 2)
            after.append(rest[there] ** 2)
    if not before:  # too short to leave anything out: the prediction error is unknown
        return ValidatedFormula(Formula(), 0.0, 1.0, ar1)
    return ValidatedFormula(formula, *share_explained(before, after), ar1)


def _folds(series: Sequence[ResidualSeries]) -> list[tuple[list[ResidualSeries], list[ResidualSeries]]]:
    """Each recording left out once, several at a time where there are many; of few recordings each block."""
    parts, count = list(series), min(len(series), MAX_FOLDS)
    if count < MIN_RECORDINGS:
        guard = round(GUARD / parts[0].step)
        cut = [piece for piece in _blocks(parts) if len(piece.target) > MIN_BLOCK_LENGTH // 2 + 2 * guard]
        parts = [piece.part(guard, len(piece.target) - guard) for piece in cut]
        count = len(parts) if len(parts) > 1 else 0
    return [([p for k, p in enumerate(parts) if k % count != fold], parts[fold::count]) for fold in range(count)]


def _blocks(series: Sequence[ResidualSeries]) -> list[ResidualSeries]:
    """Recordings cut into enough blocks to leave one out, none shorter than necessary."""
    total = sum(len(part.target) for part in series)
    length = max(MIN_BLOCK_LENGTH, total // MIN_BLOCKS)
    found = []
    for part in series:
        count = max(1, round(len(part.target) / length))
        edges = np.linspace(0, len(part.target), count + 1).astype(int)
        found += [part.part(int(first), int(last)) for first, last in pairwise(edges)]
    return found


def _search(series: Sequence[ResidualSeries], ar1: float, periodic_over: Sequence[str]) -> Formula:
    """The sparsest formula that predicts left-out blocks within one standard error of the best."""
    blocks = _blocks(series)
    y = [quasi_difference(part.target, ar1) for part in blocks]
    keep = [np.isfinite(part) for part in y]
    target = np.concatenate([a[k] for a, k in zip(y, keep, strict=True)])
    owner = np.concatenate([np.full(k.sum(), number) for number, k in enumerate(keep)])
    if len(target) < 2 * MIN_BLOCK_LENGTH or not target.std() > 0.0:
        return Formula()
    centred = target - target.mean()
    terms, columns = list[Term](), list[Array]()

    def add(term: Term) -> None:
        parts = [quasi_difference(term.column(part), ar1)[k] for part, k in zip(blocks, keep, strict=True)]
        values = np.concatenate(parts)
        if np.isfinite(values).all() and values.std() > 1e-9 * max(float(np.abs(values).max()), 1e-300):
            terms.append(term)
            columns.append(values - values.mean())

    for term in _library(blocks):
        add(term)
    for _ in range(2):  # ripples of the residual itself, then of the residual after the first group of terms
        rest = _after_first_group(columns, terms, centred) if any(term.periodic for term in terms) else centred
        for variable in periodic_over:
            for modulation in modulations(blocks):
                period = _period(blocks, ar1, rest, variable, modulation)
                if period is not None:
                    for term in ripple(variable, period, modulation):
                        add(term)
    if not columns:
        return Formula()
    chosen = [k for group in _selected(_ranked(columns, terms, centred), columns, centred, owner) for k in group]
    if not chosen:
        return Formula()
    coefficients = np.linalg.lstsq(np.column_stack([columns[k] for k in chosen]), centred, rcond=None)[0]
    formula = Formula(tuple(terms[k] for k in chosen), tuple(map(float, coefficients)))
    return replace(formula, constant=float(np.nanmean(np.concatenate([formula.residual(part) for part in blocks]))))


def _library(blocks: Sequence[ResidualSeries]) -> list[Term]:
    """Physical terms of the measured variables: each variable alone, and times functions of the speed of the axis."""
    names = list(blocks[0].variables)
    moved = [name for name in names if name.startswith("direction of ")]
    axis = moved[0].removeprefix("direction of ") if len(moved) == 1 else ""
    motions: list[tuple[Factor, ...]] = [()]
    bases: list[tuple[Factor, ...]] = [()]
    for name in names:
        if name == f"speed of {axis}":
            motions += [(Factor(function, name),) for function in ("identity", "abs", "signed square", "cube")]
        elif name == f"direction of {axis}":
            motions.append((Factor("identity", name),))
        else:
            bases += [(factor,) for factor in _functions(name, blocks)]
    return [Term((*base, *motion)) for base in bases for motion in motions if base or motion]


def _functions(name: str, blocks: Sequence[ResidualSeries]) -> list[Factor]:
    """Functions of a variable on which a residual may depend; of a position about the middle of its readings."""
    if name.startswith(("direction of ", "reversal of ", "small commands of ", "other axes together")) or name == "time":
        return [Factor("identity", name)]
    if name.startswith("time "):
        return [Factor("identity", name), Factor("decay", name, 0.3), Factor("decay", name, 1.0)]
    if name.startswith("speed of "):
        return [Factor("identity", name), Factor("abs", name)]
    if name.endswith(".command"):
        return [Factor("identity", name), Factor("signed square", name), Factor("cube", name)]
    centre = float(f"{np.median(np.concatenate([part.variables[name] for part in blocks])):.2g}")
    if name.startswith("load of ") or centre == 0.0:
        return [Factor("identity", name), Factor("square", name)]
    return [Factor("offset", name, centre), Factor("offset square", name, centre)]


def _period(
    blocks: Sequence[ResidualSeries], ar1: float, y: Array, variable: str, modulation: tuple[Factor, ...]
) -> float | None:
    """Period at the peak of the periodogram of ``y`` over a variable; None where its span is too short for a period."""
    z = np.concatenate([block.variables[variable] for block in blocks])
    moved = np.concatenate([np.abs(np.diff(block.variables[variable])) for block in blocks])
    low, high = np.percentile(z, (0.5, 99.5))
    frequencies = Frequencies.of(float(high - low), moved)
    if frequencies is None:
        return None
    whole = [Periodogram.of(blocks, variable, modulation, ar1, y)]
    return best_period(whole, searched(whole, frequencies), frequencies)


def _ranked(columns: Sequence[Array], terms: Sequence[Term], y: Array) -> list[Group]:
    """Groups of columns by explained variance (orthogonal matching pursuit); of nearly equal groups the simpler one first.

    Only groups that enter within the first steps of the lasso path are tested.
    """
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.linear_model import lars_path

    X = np.column_stack(columns)
    X = X / np.linalg.norm(X, axis=0)
    with warnings.catch_warnings():  # collinear terms are expected: the path drops one of them and warns
        warnings.simplefilter("ignore", ConvergenceWarning)
        path = lars_path(X, y, method="lasso", max_iter=PATH_STEPS)[2]
    entered = {terms[int(k)].group for k in np.flatnonzero(np.any(path != 0.0, axis=1))}
    groups: dict[tuple[Factor, ...], Group] = {}
    for k, term in enumerate(terms):
        if any(set(term.group) <= set(known) for known in entered):  # and the groups contained in them
            groups[term.group] = (*groups.get(term.group, ()), k)
    taken: list[Group] = []
    basis, rest = np.zeros((len(y), 0)), y
    while len(taken) < MAX_GROUPS and groups:
        gains = {}
        for name, members in groups.items():
            part = X[:, members] - basis @ (basis.T @ X[:, members])
            Q, R = np.linalg.qr(part)
            gains[name] = float(np.sum((Q.T @ rest) ** 2)) if np.abs(np.diag(R)).min() > 1e-6 else 0.0
        most = max(gains.values())
        if most <= 1e-10 * float(y @ y):
            break
        near = [name for name, gain in gains.items() if gain > 0.99 * most]
        best = min(near, key=lambda name: (len(name), -gains[name]))
        taken.append(groups.pop(best))
        basis = np.linalg.qr(X[:, [k for members in taken for k in members]])[0]
        rest = y - basis @ (basis.T @ y)
    return taken


def _after_first_group(columns: Sequence[Array], terms: Sequence[Term], y: Array) -> Array:
    """Residual after the first group of terms."""
    groups = _ranked(columns, terms, y)
    if not groups:
        return y
    Q = np.linalg.qr(np.column_stack([columns[k] for k in groups[0]]))[0]
    return np.asarray(y - Q @ (Q.T @ y))


def _selected(groups: list[Group], columns: Sequence[Array], y: Array, owner: npt.NDArray[np.int64]) -> list[Group]:
    """The groups that the one-standard-error rule keeps, without those that explain less than :data:`MIN_SHARE`."""
    places = {k: place + 1 for place, k in enumerate(k for group in groups for k in group)}
    X = np.column_stack([np.ones(len(y)), *(columns[k] / np.linalg.norm(columns[k]) for k in places), y])
    count = np.bincount(owner)
    grams = np.array([X[owner == block].T @ X[owner == block] for block in range(len(count))])

    def errors(taken: Sequence[Group]) -> Array:
        return _left_out_errors(grams, [0, *(places[k] for group in taken for k in group)], count)

    sizes = [errors(groups[:size]) for size in range(len(groups) + 1)]
    best = min(sizes, key=lambda e: float(e.mean()))
    limits = [best.mean() + np.std(e - best) / np.sqrt(len(e)) for e in sizes]
    kept = groups[: next(k for k, e in enumerate(sizes) if e.mean() <= limits[k])]
    least = MIN_SHARE * float(sizes[0].mean())
    while kept:
        full = errors(kept).mean()
        without = [[g for g in kept if g is not group] for group in kept]
        reduced = min(without, key=lambda rest: float(errors(rest).mean()))
        if errors(reduced).mean() - full >= least:
            break
        kept = reduced
    return kept


def _left_out_errors(grams: Array, taken: list[int], count: npt.NDArray[np.int64]) -> Array:
    """Mean squared error of each block under the regression of the last column on ``taken`` in all other blocks.

    Args:
        grams: ``XᵀX`` of each block, (blocks, columns, columns).
    """
    total, errors = grams.sum(axis=0), np.empty(len(grams))
    for block, own in enumerate(grams):
        rest = total - own
        beta = np.linalg.lstsq(rest[np.ix_(taken, taken)], rest[taken, -1], rcond=1e-12)[0]
        errors[block] = own[-1, -1] - 2.0 * beta @ own[taken, -1] + beta @ own[np.ix_(taken, taken)] @ beta
    return errors / np.maximum(count, 1)
