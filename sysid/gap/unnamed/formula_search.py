"""The form of a remainder: few physical terms and periods, found by sparse regression, judged on what they were not fitted to.

A term is a product of factors of what was measured (``load of boom``, ``|speed of boom|``, ``sin(2π·boom.cylinder/P)``).
Terms are screened by the path of the lasso (least angle regression, Efron et al. 2004; scikit-learn), periods come from a
least-squares periodogram (Lomb 1976; Scargle 1982) of the same columns, sine and cosine as one group; how many groups are kept
is decided by cross-validation over blocks, within one standard error of the best. The search itself is repeated without each
recording in turn, so that the share of variance that a form explains is one of recordings of which it knows nothing.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from sysid.gap.evidence import gain_p_value
from sysid.gap.unnamed.periodogram import Waves, best_period
from sysid.gap.unnamed.probes import PARTS, Series, colour_of, quasi_difference
from sysid.gap.unnamed.terms import Factor, Form, Term, modulations

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

#: Most groups of terms in a form.
MOST = 4
#: Recordings are cut into so many blocks at least, each of them at least so long [entries].
BLOCKS, LEAST_BLOCK = 6, 60
#: Steps of the lasso's path whose terms are tried.
STEPS = 12
#: Terms that explain less than this of the variance are not worth their words.
WORTH = 0.01


@dataclass(frozen=True)
class Judged:
    """A form, and how it does where it was not fitted.

    Args:
        share: of the prewhitened variance of recordings that the search did not see.
        p_value: that it does not predict them better than a constant.
        colour: autocorrelation of what it leaves.
    """

    form: Form
    share: float
    p_value: float
    colour: float


def find_form(series: Sequence[Series], waves: Iterable[str], seed: int = 0) -> Judged:
    """The form of a remainder, and its share on recordings that were left out of the search.

    Args:
        waves: variables over which it may repeat itself.
    """
    series = _alike(series)
    over = tuple(name for name in waves if name in series[0].variables)
    colour = colour_of([part.target for part in series])
    form = _search(_blocks(series), colour, over)
    left = colour_of([part.target - form.predict(part) for part in series])
    if left < colour - 0.05:  # what is explained had a colour of its own
        colour = left
        form = _search(_blocks(series), colour, over)
    before, after = [], []
    for inside, outside in _folds(series):
        found = _search(_blocks(inside), colour, over)
        for part in outside:
            rest = quasi_difference(part.target - found.predict(part), colour)
            plain = quasi_difference(part.target - np.nanmean(np.concatenate([s.target for s in inside])), colour)
            there = np.isfinite(rest)
            before.append(plain[there] ** 2)
            after.append(rest[there] ** 2)
    if not before:  # too short to leave anything out: nothing is known of how well it predicts
        return Judged(Form(), 0.0, 1.0, colour)
    total, rest = np.concatenate(before), np.concatenate(after)
    share = 1.0 - float(rest.sum() / total.sum()) if total.sum() > 0.0 else 0.0
    return Judged(form, share, gain_p_value(total - rest, seed), colour)


def _search(blocks: Sequence[Series], colour: float, waves: Sequence[str]) -> Form:
    """The sparse form that predicts left-out blocks within one standard error of the best."""
    y = [quasi_difference(part.target, colour) for part in blocks]
    keep = [np.isfinite(part) for part in y]
    target = np.concatenate([a[k] for a, k in zip(y, keep, strict=True)])
    owner = np.concatenate([np.full(k.sum(), number) for number, k in enumerate(keep)])
    if len(target) < 2 * LEAST_BLOCK or not target.std() > 0.0:
        return Form()

    def column(term: Term) -> Array:
        parts = (quasi_difference(term.column(part), colour)[k] for part, k in zip(blocks, keep, strict=True))
        return np.concatenate(list(parts))

    terms, columns = list[Term](), list[Array]()

    def offer(term: Term) -> None:
        values = column(term)
        if np.isfinite(values).all() and values.std() > 1e-9 * max(float(np.abs(values).max()), 1e-300):
            terms.append(term)
            columns.append(values - values.mean())

    for term in _library(blocks):
        offer(term)
    centred = target - target.mean()
    for _ in range(2):  # ripples of the remainder itself, then of what the first of the terms leaves
        rest = centred if not any(term.wave for term in terms) else _leftover(columns, terms, centred)
        for variable in waves:
            for modulation in modulations(blocks):
                period = _period(blocks, keep, colour, rest, variable, modulation)
                if period is not None:
                    for how in ("sin", "cos"):
                        offer(Term((Factor(how, variable, period), *modulation)))
    if not columns:
        return Form()
    groups = _sized(_order(columns, centred, terms), columns, centred, owner)
    return _fitted([terms[k] for group in groups for k in group], blocks, column, centred)


def _leftover(columns: Sequence[Array], terms: Sequence[Term], y: Array) -> Array:
    """What the first group of terms leaves."""
    groups = _order(columns, y, terms)
    if not groups:
        return y
    Q = np.linalg.qr(np.column_stack([columns[k] for k in groups[0]]))[0]
    return np.asarray(y - Q @ (Q.T @ y))


def _sized(
    groups: list[tuple[int, ...]], columns: Sequence[Array], y: Array, owner: npt.NDArray[np.int64]
) -> list[tuple[int, ...]]:
    """As many groups as left-out blocks can tell from chance (one-standard-error rule), without those that hardly matter."""
    places = {k: place + 1 for place, k in enumerate(k for group in groups for k in group)}
    X = np.column_stack([np.ones(len(y)), *(columns[k] / np.linalg.norm(columns[k]) for k in places), y])
    count = np.bincount(owner)
    grams = np.array([X[owner == block].T @ X[owner == block] for block in range(len(count))])

    def errors(taken: Sequence[tuple[int, ...]]) -> Array:
        return _left_out(grams, [0, *(places[k] for group in taken for k in group)], count)

    sizes = [errors(groups[:size]) for size in range(len(groups) + 1)]
    best = min(sizes, key=lambda e: float(e.mean()))
    limits = [best.mean() + np.std(e - best) / np.sqrt(len(e)) for e in sizes]
    kept = groups[: next(k for k, e in enumerate(sizes) if e.mean() <= limits[k])]
    worth = WORTH * float(sizes[0].mean())
    while kept:
        full = errors(kept).mean()
        without = [[g for g in kept if g is not group] for group in kept]
        least = min(without, key=lambda rest: float(errors(rest).mean()))
        if errors(least).mean() - full >= worth:
            break
        kept = least
    return kept


def _fitted(terms: Sequence[Term], blocks: Sequence[Series], column: Callable[[Term], Array], y: Array) -> Form:
    from sklearn.linear_model import LinearRegression

    if not terms:
        return Form()
    X = np.column_stack([column(term) for term in terms])
    model = LinearRegression().fit(X, y)
    coefficients = tuple(map(float, model.coef_))
    rest = [part.target - Form(tuple(terms), coefficients).predict(part) for part in blocks]
    return Form(tuple(terms), coefficients, float(np.nanmean(np.concatenate(rest))))


def _left_out(grams: Array, taken: list[int], count: npt.NDArray[np.int64]) -> Array:
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


def _order(columns: Sequence[Array], y: Array, terms: Sequence[Term]) -> list[tuple[int, ...]]:
    """Groups of columns, the one that explains most first, then what explains most of the rest; of equals the plainer.

    Only what the first steps of the lasso's path bring in is tried.
    """
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.linear_model import lars_path

    X = np.column_stack(columns)
    X = X / np.linalg.norm(X, axis=0)
    with warnings.catch_warnings():  # terms that say the same are expected here; the path drops one of them and says so
        warnings.simplefilter("ignore", ConvergenceWarning)
        path = lars_path(X, y, method="lasso", max_iter=STEPS)[2]
    entered = {terms[int(k)].group for k in np.flatnonzero(np.any(path != 0.0, axis=1))}
    groups: dict[tuple[Factor, ...], tuple[int, ...]] = {}
    for k, term in enumerate(terms):
        if any(not term.group or set(term.group) <= set(known) for known in entered):  # and what they are made of
            groups[term.group] = (*groups.get(term.group, ()), k)
    taken: list[tuple[int, ...]] = []
    basis, rest = np.zeros((len(y), 0)), y
    while len(taken) < MOST and groups:
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


def _library(blocks: Sequence[Series]) -> list[Term]:
    """Physical terms of what was measured: each variable alone, and with the speed of the axis in its several forms."""
    names = list(blocks[0].variables)
    moved = [name for name in names if name.startswith("direction of ")]
    axis = moved[0].removeprefix("direction of ") if len(moved) == 1 else ""
    speed, way = f"speed of {axis}", f"direction of {axis}"
    motions: list[tuple[Factor, ...]] = [()]
    bases: list[tuple[Factor, ...]] = [()]
    for name in names:
        centre = float(f"{np.median(np.concatenate([part.variables[name] for part in blocks])):.2g}")
        if name == speed:
            motions += [(Factor(how, name),) for how in ("is", "abs", "signed square", "cube")]
        elif name == way:
            motions.append((Factor("is", name),))
        elif name.startswith(("direction of ", "reversal of ", "small commands of ")):
            bases.append((Factor("is", name),))
        elif name.startswith("time ") or name == "time":
            bases.append((Factor("is", name),))
            bases += [(Factor("fading", name, seconds),) for seconds in (0.3, 1.0)] if name != "time" else []
        elif name.startswith("speed of ") or name == "other axes together":
            bases += (
                [(Factor("is", name),), (Factor("abs", name),)] if name != "other axes together" else [(Factor("is", name),)]
            )
        elif name.endswith(".command"):
            bases += [(Factor(how, name),) for how in ("is", "signed square", "cube")]
        elif name.startswith("load of "):
            bases += [(Factor("is", name),), (Factor("square", name),)]
        else:
            bases += [(Factor("off", name, centre),), (Factor("off square", name, centre),)]
    return [Term((*base, *motion)) for base in bases for motion in motions if base or motion]


def _period(
    blocks: Sequence[Series], keep: Sequence[Mask], colour: float, y: Array, variable: str, modulation: tuple[Factor, ...]
) -> float | None:
    """Where the periodogram of ``y`` over a variable is highest; None where it has no room for a period."""
    z = np.concatenate([block.variables[variable] for block in blocks])
    size = np.concatenate([Term(modulation).values(block) for block in blocks])
    moved = np.concatenate([np.abs(np.diff(block.variables[variable])) for block in blocks])
    begin, ends = list[Rows](), 0
    for block, there in zip(blocks, keep, strict=True):
        begin.append(ends + PARTS * (np.flatnonzero(there) + 1))  # the first entry of a block has none before it
        ends += len(block.variables[variable])
    at = np.concatenate(begin).astype(np.int64)
    low, high = np.percentile(z, (0.5, 99.5))
    return best_period([Waves(z, size, at, blocks[0].weights, colour, y)], float(high - low), moved)


def _blocks(series: Sequence[Series]) -> list[Series]:
    """Recordings cut until there are enough blocks to leave one out, and no shorter than they have to be."""
    total = sum(len(part.target) for part in series)
    length = max(LEAST_BLOCK, total // BLOCKS)
    found = []
    for part in series:
        count = max(1, round(len(part.target) / length))
        edges = np.linspace(0, len(part.target), count + 1).astype(int)
        found += [part.part(int(a), int(b), f"{part.name}#{k}") for k, (a, b) in enumerate(pairwise(edges))]
    return found


def _alike(series: Sequence[Series]) -> list[Series]:
    """With the variables that all recordings have: a form speaks of nothing else."""
    shared = [name for name in series[0].variables if all(name in part.variables for part in series)]
    return [replace(part, variables={name: part.variables[name] for name in shared}) for part in series]


def _folds(series: Sequence[Series]) -> list[tuple[list[Series], list[Series]]]:
    """Each recording left out once; with fewer than three of them, blocks with a guard of the neighbours' ends."""
    parts = list(series)
    if len(parts) > 6:  # leave out several at a time: as many searches as with six
        return [([p for k, p in enumerate(parts) if k % 6 != fold], parts[fold::6]) for fold in range(6)]
    if len(parts) < 3:
        guard = round(2.0 / parts[0].step)
        cut = [piece for piece in _blocks(parts) if len(piece.target) > LEAST_BLOCK // 2 + 2 * guard]
        parts = [piece.part(guard, len(piece.target) - guard, piece.name) for piece in cut]
    return [([p for p in parts if p is not left], [left]) for left in parts] if len(parts) > 1 else []
