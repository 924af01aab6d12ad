"""Statistics of long signals, computed in chunks, so that intermediate results take no memory.

Every result is bit-identical to that of the NumPy expression in the docstring.
"""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
import numpy.typing as npt

from sysid.scratch import MAPPED_PIECES, PIECE, chosen, computed, leave, pieces

P = ParamSpec("P")
T = TypeVar("T")

Array = npt.NDArray[np.float64]
Values = npt.NDArray[Any]
Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.intp]
Stamps = npt.NDArray[np.int64]


#: Number of rows and (first, last + 1) → their values without NaN, as many as there are; of one signal or of several.
Parts = Sequence[tuple[int, Callable[[int, int], Array]]]
#: Values of a sample that brackets quantiles, and width of the bracket in standard deviations of its rank.
_SAMPLE, _BRACKET = 2**16, 6.0
#: Results of :func:`remembered` of each signal that exists, by its id.
_results: dict[int, dict[Hashable, Any]] = {}


def remembered(work: Callable[Concatenate[Array, P], T]) -> Callable[Concatenate[Array, P], T]:
    """``work`` of a signal (n,), computed once for each read-only signal: those of a recording are asked for many times."""

    @functools.wraps(work)
    def once(values: Array, /, *args: P.args, **kwargs: P.kwargs) -> T:
        if values.flags.writeable:
            return work(values, *args, **kwargs)
        if id(values) not in _results:
            _results[id(values)] = {}
            weakref.finalize(values, _results.pop, id(values)).atexit = False
        known, key = _results[id(values)], (work, args, *kwargs.items())
        if key not in known:
            known[key] = work(values, *args, **kwargs)
        found: T = known[key]
        return found

    return once


def copied(values: Values) -> Values:
    """A copy (n,)."""
    return computed(len(values), lambda first, last: values[first:last], values.dtype)


def strided(values: Values, stride: int) -> Values:
    """A copy of ``values[::stride]`` of a signal (n,)."""
    parts, rows = [values[:0].copy()], max(PIECE // stride, 1) * stride
    for number, first in enumerate(range(0, len(values), rows)):
        parts.append(values[first : first + rows : stride].copy())
        if number % MAPPED_PIECES == MAPPED_PIECES - 1:
            leave()
    return np.concatenate(parts)


def earlier(values: Array, delay: int) -> Array:
    """The rows with another one ``delay`` rows later, the partners of ``values[delay:]``: none where there are too few."""
    return values[: max(len(values) - delay, 0)]


def differences(values: Values, order: int = 1) -> Values:
    """``np.diff(values, order)`` of a signal (n,)."""
    count = max(len(values) - order, 0)
    return computed(count, lambda first, last: np.diff(values[first : last + order], order), values.dtype)


def known(values: Array) -> Array:
    """A signal (n,) without its missing values; itself where none is missing."""
    return chosen(values, ~np.isnan(values)) if len(values) <= PIECE or missing(values) else values


def finite(values: Array) -> Array:
    """``np.nan_to_num(values)`` of some values; themselves where all are finite."""
    return values if np.isfinite(values).all() else np.nan_to_num(values)


def masked(count: int, piece: Callable[[int, int], Mask]) -> Mask:
    """A mask (count,); ``piece(first, last + 1)`` returns a part of it."""
    return computed(count, piece, np.bool_)


def counted(count: int, piece: Callable[[int, int], Mask]) -> int:
    """Number of True values of a mask that ``piece`` returns as for :func:`masked`."""
    return sum(int(np.count_nonzero(piece(first, last))) for first, last in pieces(count))


def measured(values: Array) -> bool:
    """``not np.isnan(values).all()`` of a signal (n,)."""
    return any(not np.isnan(values[first:last]).all() for first, last in pieces(len(values)))


def missing(values: Array) -> int:
    """Number of missing values of a signal (n,)."""
    return counted(len(values), lambda first, last: np.isnan(values[first:last]))


@remembered
def ends(values: Array) -> tuple[float, float]:
    """``np.nanmin(values)`` and ``np.nanmax(values)`` of a signal (n,); NaN without a value."""
    each = [(np.fmin.reduce(values[a:b]), np.fmax.reduce(values[a:b])) for a, b in pieces(len(values))] or [(np.nan, np.nan)]
    lows, highs = zip(*each, strict=True)
    return float(np.fmin.reduce(lows)), float(np.fmax.reduce(highs))


def median(values: Values) -> float:
    """``np.median(values)`` of (n,), which is reordered in place: pass a copy where the values are needed later."""
    places = [(len(values) - 1) // 2, len(values) // 2, len(values) - 1]  # NaN is last
    values.partition(places)
    low, high, last = values[places]
    return float(last if np.isnan(last) else (low + high) / 2 + 0.0)


def quantiles(parts: Parts, shares: Sequence[float]) -> list[float]:
    """``np.quantile(values, shares)`` of all values of ``parts``, without an array of them; NaN without one."""
    return [float(np.quantile(np.array([low, high]), place)) for low, high, place in _neighbours(parts, shares)]


def median_of(parts: Parts, least: int = 1) -> float:
    """``np.median(values)`` of all values of ``parts``, without an array of them; NaN with fewer than ``least``."""
    ((low, high, place),) = _neighbours(parts, (0.5,), least)
    return float(np.mean([low, high])) if place else low


def _neighbours(parts: Parts, shares: Sequence[float], least: int = 1) -> list[tuple[float, float, float]]:
    """The two values in order around each quantile, and its place between them."""
    step = max(sum(count for count, _ in parts) // _SAMPLE, 1)
    total, sample = 0, []
    for some in _each(parts):
        sample.append(some[total % step :: step].copy())
        total += len(some)
    if total < least:
        return [(float("nan"), float("nan"), 0.0)] * len(shares)
    ordered = np.sort(np.concatenate(sample))
    places = [(total - 1) * share for share in shares]
    pairs = [(int(place), min(int(place) + 1, total - 1)) for place in places]
    if step == 1:
        found = [(float(ordered[low]), float(ordered[high])) for low, high in pairs]
    else:
        found = _selected(parts, ordered, pairs, total)
    return [(*ends, place - low) for ends, (low, _), place in zip(found, pairs, places, strict=True)]


def _each(parts: Parts) -> Iterator[Array]:
    for count, piece in parts:
        for first, last in pieces(count):
            yield piece(first, last)


def _selected(parts: Parts, sample: Array, pairs: Sequence[tuple[int, int]], total: int) -> list[tuple[float, float]]:
    """The values at the ranks of each pair of neighbours among all ``total`` values in order.

    An ordered sample of them brackets each pair, and only the values in the bracket are ordered (Floyd and Rivest,
    Communications of the ACM 18 (1975) 165).
    """
    brackets = []
    for pair in pairs:
        at, size = pair[0] / total, len(sample)
        slack = 2.0 + _BRACKET * float(np.sqrt(at * (1.0 - at) * size))
        first, last = int(np.floor(at * size - slack)), int(np.ceil(at * size + slack))
        low = float(sample[first]) if first >= 0 else -np.inf
        brackets.append(_Bracket(low, float(sample[last]) if last < size else np.inf))
    for some in _each(parts):
        for bracket in brackets:
            bracket.take(some)
    found = []
    for bracket, pair in zip(brackets, pairs, strict=True):
        ends = bracket.values(pair)
        if ends is None:  # the sample misleads
            ends = np.partition(np.concatenate(list(_each(parts))), pair)[list(pair)]
        found.append((float(ends[0]), float(ends[1])))
    return found


class _Bracket:
    """The values of a signal between two, and the numbers of those below and at the lower one."""

    def __init__(self, low: float, high: float) -> None:
        self.low, self.high, self.below, self.level = low, high, 0, 0
        self.inside: list[Array] = []

    def take(self, values: Array) -> None:
        above = values[values >= self.low]
        over = above[above > self.low]
        self.below += len(values) - len(above)
        self.level += len(above) - len(over)
        self.inside.append(over[over < self.high])

    def values(self, ranks: Sequence[int]) -> Array | None:
        """The values at ``ranks`` of all in order; None where one is outside."""
        between = np.concatenate(self.inside)
        places = [rank - self.below for rank in ranks]
        if min(places) < 0 or max(places) >= self.level + len(between):
            return None
        own = [place - self.level for place in places if place >= self.level]
        if own:
            between.partition(own)
        return np.array([self.low if place < self.level else between[place - self.level] for place in places])


def median_step(values: Values) -> float:
    """``np.median(np.diff(values))`` of at least two stamps or times (n,)."""
    return median(differences(values))


def mean_square(values: Array) -> float:
    """``np.mean(values**2)``."""
    return float(computed(len(values), lambda first, last: values[first:last] ** 2).sum() / len(values))


def deviation(values: Array) -> float:
    """``np.std(values)``."""
    mean = values.sum() / len(values)
    away = computed(len(values), lambda first, last: values[first:last] - mean)
    np.multiply(away, away, out=away)
    return float(np.sqrt(away.sum() / len(values)))


def stretches(mask: Mask) -> tuple[Rows, Rows]:
    """First and last + 1 of each stretch of True of a mask (n,)."""
    if not len(mask):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    edges = np.flatnonzero(mask[1:] != mask[:-1]) + 1
    ends = np.concatenate([np.arange(int(mask[0])), edges, np.full(int(mask[-1]), len(mask))])
    return ends[::2], ends[1::2]


def longest_run(mask: Mask) -> int:
    """Length of the longest stretch of True."""
    first, last = stretches(mask)
    return int((last - first).max(initial=0))


def absolute(values: Array) -> Array:
    """``np.abs(values)``, in the place of ``values``."""
    return np.abs(values, out=values)


def sosfiltfilt_in_place(sections: Array, values: Array, padding: int) -> None:
    """``scipy.signal.sosfiltfilt(sections, values, padlen=padding)`` in place, in chunks."""
    from scipy.signal import sosfilt, sosfilt_zi

    before = 2.0 * values[0] - values[padding:0:-1]
    after = 2.0 * values[-1] - values[-2 : -(padding + 2) : -1]
    parts = [values[first:last] for first, last in pieces(len(values))]
    settled = sosfilt_zi(sections)
    first = before[0] if padding else values[0]
    _, state = sosfilt(sections, before, zi=settled * first) if padding else (before, settled * first)
    for part in parts:
        part[:], state = sosfilt(sections, part, zi=state)
    if padding:
        after, state = sosfilt(sections, after, zi=state)
        _, state = sosfilt(sections, after[::-1], zi=settled * after[-1])
    else:
        state = settled * values[-1]
    for part in reversed(parts):
        backwards, state = sosfilt(sections, part[::-1], zi=state)
        part[:] = backwards[::-1]
