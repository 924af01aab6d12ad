"""Formula of a residual: a few physical terms and periods, found by sparse regression, validated on recordings left out.

A term is a product of factors of measured variables (``load of boom``, ``|speed of boom|``, ``sin(2π·boom.cylinder/P)``).
Terms are screened by the path of the lasso (least angle regression, Efron et al. 2004; scikit-learn), periods come from a
least-squares periodogram (Lomb 1976; Scargle 1982) of the same columns, sine and cosine as one group; the number of groups
is chosen by cross-validation over blocks, within one standard error of the best. The whole search is repeated without each
recording in turn, so that the explained share of variance is that of recordings unknown to the search.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from sysid.gap.unnamed.periodogram import Frequencies, Periodogram, best_period, searched
from sysid.gap.unnamed.residual_series import PARTS, ResidualSeries, gain_p_value, lag1_autocorrelation, quasi_difference
from sysid.gap.unnamed.terms import Factor, Formula, Term, modulations

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

#: Largest number of groups of terms in a formula.
MAX_GROUPS = 4
#: Least number of blocks into which recordings are cut, and least length of a block [entries].
MIN_BLOCKS, MIN_BLOCK_LENGTH = 6, 60
#: Steps of the lasso path whose terms are tested.
PATH_STEPS = 12
#: Groups of terms that explain less than this share of the variance are dropped.
MIN_SHARE = 0.01


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


def find_formula(series: Sequence[ResidualSeries], periodic_over: Iterable[str], seed: int = 0) -> ValidatedFormula:
    """The formula of a residual, and its explained share on recordings left out of the search.

    Args:
        periodic_over: variables over which the residual may be periodic.
    """
    series = _with_shared_variables(series)
    periodic_over = tuple(name for name in periodic_over if name in series[0].variables)
    ar1 = lag1_autocorrelation([part.target for part in series])
    formula = _search(_blocks(series), ar1, periodic_over)
    left = lag1_autocorrelation([part.target - formula.predict(part) for part in series])
    if left < ar1 - 0.05:  # the explained part was autocorrelated itself
        ar1 = left
        formula = _search(_blocks(series), ar1, periodic_over)
    before, after = [], []
    for inside, outside in _folds(series):
        found = _search(_blocks(inside), ar1, periodic_over)
        for part in outside:
            rest = quasi_difference(part.target - found.predict(part), ar1)
            plain = quasi_difference(part.target - np.nanmean(np.concatenate([s.target for s in inside])), ar1)
            there = np.isfinite(rest)
            before.append(plain[there] ** 2)
            after.append(rest[there] ** 2)
    if not before:  # too short to leave anything out: the prediction error is unknown
        return ValidatedFormula(Formula(), 0.0, 1.0, ar1)
    total, rest = np.concatenate(before), np.concatenate(after)
    share = 1.0 - float(rest.sum() / total.sum()) if total.sum() > 0.0 else 0.0
    return ValidatedFormula(formula, share, gain_p_value(total - rest, seed), ar1)


def _search(blocks: Sequence[ResidualSeries], ar1: float, periodic_over: Sequence[str]) -> Formula:
    """The sparsest formula that predicts left-out blocks within one standard error of the best."""
    y = [quasi_difference(part.target, ar1) for part in blocks]
    keep = [np.isfinite(part) for part in y]
    target = np.concatenate([a[k] for a, k in zip(y, keep, strict=True)])
    owner = np.concatenate([np.full(k.sum(), number) for number, k in enumerate(keep)])
    if len(target) < 2 * MIN_BLOCK_LENGTH or not target.std() > 0.0:
        return Formula()

    def column(term: Term) -> Array:
        parts = (quasi_difference(term.column(part), ar1)[k] for part, k in zip(blocks, keep, strict=True))
        return np.concatenate(list(parts))

    terms, columns = list[Term](), list[Array]()

    def add(term: Term) -> None:
        values = column(term)
        if np.isfinite(values).all() and values.std() > 1e-9 * max(float(np.abs(values).max()), 1e-300):
            terms.append(term)
            columns.append(values - values.mean())

    for term in _library(blocks):
        add(term)
    centred = target - target.mean()
    for _ in range(2):  # ripples of the residual itself, then of the residual after the first group of terms
        rest = centred if not any(term.periodic for term in terms) else _after_first_group(columns, terms, centred)
        for variable in periodic_over:
            for modulation in modulations(blocks):
                period = _period(blocks, keep, ar1, rest, variable, modulation)
                if period is not None:
                    for function in ("sin", "cos"):
                        add(Term((Factor(function, variable, period), *modulation)))
    if not columns:
        return Formula()
    groups = _selected(_ranked(columns, centred, terms), columns, centred, owner)
    return _fit([terms[k] for group in groups for k in group], blocks, column, centred)


def _after_first_group(columns: Sequence[Array], terms: Sequence[Term], y: Array) -> Array:
    """Residual after the first group of terms."""
    groups = _ranked(columns, y, terms)
    if not groups:
        return y
    Q = np.linalg.qr(np.column_stack([columns[k] for k in groups[0]]))[0]
    return np.asarray(y - Q @ (Q.T @ y))


def _selected(
    groups: list[tuple[int, ...]], columns: Sequence[Array], y: Array, owner: npt.NDArray[np.int64]
) -> list[tuple[int, ...]]:
    """The groups that the one-standard-error rule keeps, without those that explain less than :data:`MIN_SHARE`."""
    places = {k: place + 1 for place, k in enumerate(k for group in groups for k in group)}
    X = np.column_stack([np.ones(len(y)), *(columns[k] / np.linalg.norm(columns[k]) for k in places), y])
    count = np.bincount(owner)
    grams = np.array([X[owner == block].T @ X[owner == block] for block in range(len(count))])

    def errors(taken: Sequence[tuple[int, ...]]) -> Array:
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


def _fit(terms: Sequence[Term], blocks: Sequence[ResidualSeries], column: Callable[[Term], Array], y: Array) -> Formula:
    from sklearn.linear_model import LinearRegression

    if not terms:
        return Formula()
    X = np.column_stack([column(term) for term in terms])
    model = LinearRegression().fit(X, y)
    coefficients = tuple(map(float, model.coef_))
    rest = [part.target - Formula(tuple(terms), coefficients).predict(part) for part in blocks]
    return Formula(tuple(terms), coefficients, float(np.nanmean(np.concatenate(rest))))


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


def _ranked(columns: Sequence[Array], y: Array, terms: Sequence[Term]) -> list[tuple[int, ...]]:
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
    groups: dict[tuple[Factor, ...], tuple[int, ...]] = {}
    for k, term in enumerate(terms):
        if any(not term.group or set(term.group) <= set(known) for known in entered):  # and the groups contained in them
            groups[term.group] = (*groups.get(term.group, ()), k)
    taken: list[tuple[int, ...]] = []
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


def _library(blocks: Sequence[ResidualSeries]) -> list[Term]:
    """Physical terms of the measured variables: each variable alone, and times functions of the speed of the axis."""
    names = list(blocks[0].variables)
    moved = [name for name in names if name.startswith("direction of ")]
    axis = moved[0].removeprefix("direction of ") if len(moved) == 1 else ""
    speed, direction = f"speed of {axis}", f"direction of {axis}"
    motions: list[tuple[Factor, ...]] = [()]
    bases: list[tuple[Factor, ...]] = [()]
    for name in names:
        centre = float(f"{np.median(np.concatenate([part.variables[name] for part in blocks])):.2g}")
        if name == speed:
            motions += [(Factor(function, name),) for function in ("identity", "abs", "signed square", "cube")]
        elif name == direction:
            motions.append((Factor("identity", name),))
        elif name.startswith(("direction of ", "reversal of ", "small commands of ", "other axes together")):
            bases.append((Factor("identity", name),))
        elif name.startswith("time ") or name == "time":
            bases.append((Factor("identity", name),))
            bases += [(Factor("decay", name, seconds),) for seconds in (0.3, 1.0)] if name != "time" else []
        elif name.startswith("speed of "):
            bases += [(Factor("identity", name),), (Factor("abs", name),)]
        elif name.endswith(".command"):
            bases += [(Factor(function, name),) for function in ("identity", "signed square", "cube")]
        elif name.startswith("load of "):
            bases += [(Factor("identity", name),), (Factor("square", name),)]
        else:
            bases += [(Factor("offset", name, centre),), (Factor("offset square", name, centre),)]
    return [Term((*base, *motion)) for base in bases for motion in motions if base or motion]


def _period(
    blocks: Sequence[ResidualSeries], keep: Sequence[Mask], ar1: float, y: Array, variable: str, modulation: tuple[Factor, ...]
) -> float | None:
    """Period at the peak of the periodogram of ``y`` over a variable; None where its span is too short for a period."""
    z = np.concatenate([block.variables[variable] for block in blocks])
    size = np.concatenate([Term(modulation).values(block) for block in blocks])
    moved = np.concatenate([np.abs(np.diff(block.variables[variable])) for block in blocks])
    begin, ends = list[Rows](), 0
    for block, there in zip(blocks, keep, strict=True):
        begin.append(ends + PARTS * (np.flatnonzero(there) + 1))  # the first entry of a block has none before it
        ends += len(block.variables[variable])
    at = np.concatenate(begin).astype(np.int64)
    low, high = np.percentile(z, (0.5, 99.5))
    frequencies, periodograms = Frequencies.of(float(high - low), moved), [Periodogram(z, size, at, blocks[0].weights, ar1, y)]
    return None if frequencies is None else best_period(periodograms, searched(periodograms, frequencies), frequencies)


def _blocks(series: Sequence[ResidualSeries]) -> list[ResidualSeries]:
    """Recordings cut into enough blocks to leave one out, none shorter than necessary."""
    total = sum(len(part.target) for part in series)
    length = max(MIN_BLOCK_LENGTH, total // MIN_BLOCKS)
    found = []
    for part in series:
        count = max(1, round(len(part.target) / length))
        edges = np.linspace(0, len(part.target), count + 1).astype(int)
        found += [part.part(int(a), int(b), f"{part.name}#{k}") for k, (a, b) in enumerate(pairwise(edges))]
    return found


def _with_shared_variables(series: Sequence[ResidualSeries]) -> list[ResidualSeries]:
    """The series with the variables that all recordings have: a formula uses no others."""
    shared = [name for name in series[0].variables if all(name in part.variables for part in series)]
    return [replace(part, variables={name: part.variables[name] for name in shared}) for part in series]


def _folds(series: Sequence[ResidualSeries]) -> list[tuple[list[ResidualSeries], list[ResidualSeries]]]:
    """Each recording left out once; with fewer than three recordings, blocks whose ends are cut off as a guard."""
    parts = list(series)
    if len(parts) > 6:  # leave out several at a time: as many searches as with six
        return [([p for k, p in enumerate(parts) if k % 6 != fold], parts[fold::6]) for fold in range(6)]
    if len(parts) < 3:
        guard = round(2.0 / parts[0].step)
        cut = [piece for piece in _blocks(parts) if len(piece.target) > MIN_BLOCK_LENGTH // 2 + 2 * guard]
        parts = [piece.part(guard, len(piece.target) - guard, piece.name) for piece in cut]
    return [([p for p in parts if p is not left], [left]) for left in parts] if len(parts) > 1 else []
