"""A channel: one signal from one file, in SI, still on the clock of the device that wrote it."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pandas as pd

from sysid.datasets.checks.flag import Flag
from sysid.datasets.chunked import Array, Rows, Stamps, median_step
from sysid.datasets.clocks.set_clocks import MAX_BACK_SHARE, MAX_LATE_S, set_back_rows
from sysid.datasets.recipe import SignalMap
from sysid.errors import InputError, nearest
from sysid.logs import Stream
from sysid.machine import Machine
from sysid.numbers import LARGEST_COUNT
from sysid.scratch import chosen, computed
from sysid.signals import split_signal
from sysid.units import si_factor


@dataclass(frozen=True)
class RowCounts:
    """What became of the rows of a field; the samples of its channel are what is left.

    Args:
        rows: of the stream in the file; of motion capture, its frames.
        empty: without a value of this field.
        overflows: beyond :data:`sysid.numbers.LARGEST_COUNT`.
        repeated: with stamp and value of another row.
        conflicting: with the stamp of another row, and another value; the first one is kept.
        late: out of order, sorted.
        turns: beyond a gap in which a wrapped position may have made several numbers of turns.
    """

    rows: int = 0
    empty: int = 0
    overflows: int = 0
    repeated: int = 0
    conflicting: int = 0
    late: int = 0
    turns: int = 0


@dataclass(frozen=True)
class Channel:
    """Samples of one signal with their own stamps: rows of the file without a value of the signal are none.

    Args:
        signal: canonical name.
        source: file name in the recording's folder; with ``domain`` it says which clock the stamps are on.
        stamps: int64 nanoseconds, strictly increasing, (n,).
        values: SI, (n,); of motion capture NaN in frames without the body.
        unit: their SI unit.
        counts: what became of the rows of the file.
        flags: faults found while reading; their seconds count from the first stamp.
        modulus: up to multiples of it the values are known, in ``unit``; None: they did not wrap.
    """

    signal: str
    source: str
    domain: str
    stamps: Stamps
    values: Array
    unit: str = "1"
    primary: bool = True
    interpolation: Literal["linear", "cubic"] = "linear"
    max_gap_s: float | None = None
    counts: RowCounts = field(default_factory=RowCounts)
    flags: tuple[Flag, ...] = ()
    modulus: float | None = None

    @property
    def clock(self) -> str:
        """The clock of the stamps: every file of another device has its own clock."""
        return "machine" if self.domain == "machine" else f"{self.domain}:{self.source}"

    @functools.cached_property
    def period_s(self) -> float:
        """Median time between two samples with a value [s]; NaN with fewer than two."""
        stamps = chosen(self.stamps, ~np.isnan(self.values))
        return median_step(stamps) * 1e-9 if len(stamps) > 1 else float("nan")


@dataclass(frozen=True)
class Converted:
    """A field in SI.

    Args:
        values: (n,), NaN where the source had none or an overflow.
        per_raw: change of the SI value per raw one.
        overflows: number of values beyond :data:`sysid.numbers.LARGEST_COUNT`.
        missing: number of values that the recipe states to be none.
    """

    values: Array
    unit: str
    per_raw: float
    overflows: int
    missing: int


def convert(stream: Stream, mapping: SignalMap, signal: str, machine: Machine) -> Converted:
    """The mapped field of ``stream`` in SI.

    Raises:
        InputError: no such field, the unit of the file contradicts the recipe, a unit of another quantity, or no number.
    """
    where = f"{stream.source}: {signal}"
    if mapping.field not in stream.columns:
        known = stream.fields or stream.columns
        raise InputError(where, f"no field {mapping.field!r} in {stream.name!r}", nearest(mapping.field, known))
    stated = stream.units.get(mapping.field)
    rescaled = mapping.scale != 1.0 or mapping.span != 1.0
    if stated and mapping.unit and not rescaled and si_factor(stated, where) != si_factor(mapping.unit, where):
        expected = f"[{mapping.unit}] as in the recipe"
        raise InputError(where, f"the file states [{stated}]", expected, "Correct `unit` in the recipe.")
    factor, unit = _unit(mapping.unit or (None if rescaled else stated), signal, machine, where)
    raw = stream.columns[mapping.field]
    overflows = missing = 0

    def piece(first: int, last: int) -> Array:
        values = raw[first:last] - mapping.zero
        values *= mapping.sign * mapping.scale
        values /= mapping.span
        values *= factor
        values += mapping.offset
        for number in mapping.missing:
            none = np.isclose(raw[first:last], number, rtol=1e-6, atol=0.0)  # of a float of 32 bits, too
            nonlocal missing
            missing += int(np.count_nonzero(none))
            values[none] = np.nan
        beyond = np.abs(values) > LARGEST_COUNT
        if beyond.any():
            nonlocal overflows
            overflows += int(np.count_nonzero(beyond))
            values[beyond] = np.nan
        return values

    values = computed(len(raw), piece)
    if len(raw) and np.isnan(values).all():
        raise InputError(where, f"field {mapping.field!r} has no number", "measured values", "Correct the recipe's field.")
    return Converted(values, unit, mapping.sign * mapping.scale / mapping.span * factor, overflows, missing)


#: Units of signals of an axis for which the machine description leaves rotation or translation open.
_OPEN_UNITS = {"joint": {"rad", "m"}, "speed": {"rad/s", "m/s"}}


def _unit(unit: str | None, signal: str, machine: Machine, where: str) -> tuple[float, str]:
    """Factor to SI and the SI unit of ``signal``; SI where neither file nor recipe states a unit."""
    expected = machine.expected_unit(signal)
    if unit is None:
        return 1.0, expected if expected is not None else "1"
    factor, si = si_factor(unit, where)
    allowed = {expected} if expected is not None else _OPEN_UNITS.get(split_signal(signal)[1], {"rad", "m", "N", "N·m"})
    if si not in allowed:
        raise InputError(where, f"a unit of [{si}] ({unit})", f"a unit of [{' or '.join(sorted(allowed))}]")
    return factor, si


def stored_channels(rows: pd.DataFrame) -> list[Channel]:
    """Channels of one recording from rows of :meth:`sysid.datasets.Store.channels`, in the order of their stamps."""
    found: list[Channel] = []
    for (source, domain, signal), part in rows.groupby(["source", "domain", "signal"], sort=False, observed=True):
        stamps = part["stamp_ns"].to_numpy(dtype=np.int64)
        order = np.argsort(stamps, kind="stable")  # parts of one signal may follow each other
        values = part["value"].to_numpy(dtype=np.float64)
        found.append(Channel(str(signal), str(source), str(domain), stamps[order], values[order]))
    return found


def seconds(stamps: Stamps, origin_ns: int) -> Array:
    """Stamps as seconds since ``origin_ns``."""
    return computed(len(stamps), lambda first, last: (stamps[first:last] - origin_ns) * 1e-9)


def in_order(stamps: Stamps, where: str) -> tuple[Rows, int]:
    """Rows in the order of their stamps, of those with one stamp the first, and the number of rows out of order.

    Raises:
        InputError: too many steps back in time, or too large ones, for late messages; the clock was set back.
    """
    if np.all(stamps[1:] > stamps[:-1]):
        return computed(len(stamps), np.arange, np.intp), 0
    steps = np.diff(stamps)
    back = np.flatnonzero(steps < 0)
    problem = ""
    if len(back) > max(1.0, MAX_BACK_SHARE * len(stamps)) or (len(back) and steps.min() < -MAX_LATE_S * 1e9):
        row = int(back[0]) + 2
        problem = f"stamps go back in time {len(back)} times, first in row {row} by {-steps[row - 2] * 1e-9:.6g} s"
    elif len(back) and len(reset := set_back_rows(stamps)):
        row = int(reset[0])
        problem = f"its clock was set back by {(stamps[row - 1] - stamps[row]) * 1e-9:.3f} s in row {row + 1}"
    if problem:
        remedy = "Cut the log where its clock was set, or choose another clock in the recipe."
        raise InputError(where, problem, "increasing stamps", remedy)
    order = np.argsort(stamps, kind="stable")
    keep = np.ones(len(order), dtype=bool)
    keep[1:] = np.diff(stamps[order]) > 0
    return order[keep], len(back)


def counts_of(stamps: Stamps, values: Array, order: Rows, late: int) -> RowCounts:
    """Rows of which :func:`in_order` keeps ``order``.

    Args:
        stamps: (n,); ``values``: (n, ...).
        late: rows out of order.
    """
    if len(order) == len(stamps):
        return RowCounts(rows=len(stamps), late=late)
    left = np.ones(len(stamps), dtype=bool)
    left[order] = False
    dropped = np.flatnonzero(left)
    own, kept = values[dropped], values[order[np.searchsorted(stamps[order], stamps[dropped])]]
    equal = ((own == kept) | (np.isnan(own) & np.isnan(kept))).reshape(len(dropped), -1).all(axis=1)
    repeated = int(np.count_nonzero(equal))
    return RowCounts(rows=len(stamps), repeated=repeated, conflicting=len(dropped) - repeated, late=late)
