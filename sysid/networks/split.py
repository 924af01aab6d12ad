"""Fit, select and held-out rows of networks: whole recordings, else contiguous blocks with a guard, never single samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Kind, Recording, Role
from sysid.errors import ExcitationError

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

#: Shares of a recording, from its end, that take a role which no recording has: (select, held out).
BLOCK_SHARES: dict[Kind, tuple[float, float]] = {"motion": (0.15, 0.15), "poses": (0.1, 0.1)}
#: Width of the guard between two blocks of a motion recording, whose rows belong to neither [s].
GUARD_S = 1.0
#: Bins of a stratified sample.
BINS = 50


@dataclass(frozen=True)
class RowRange:
    """Rows ``start`` to ``stop`` (excluded) of one recording."""

    recording: Recording
    start: int
    stop: int


@dataclass(frozen=True)
class SignalRows:
    """Rows of one or more recordings with all signals.

    Args:
        signals: names of the columns.
        values: (n, len(signals)) [SI].
        recording: name of the recording of each row, (n,).
        row: position in that recording's table, (n,).
        time: since that recording's start, (n,) [s].
    """

    signals: tuple[str, ...]
    values: Array
    recording: npt.NDArray[np.str_]
    row: Index
    time: Array

    def __len__(self) -> int:
        return len(self.values)

    def take(self, index: npt.NDArray[np.intp] | Index) -> SignalRows:
        return SignalRows(self.signals, self.values[index], self.recording[index], self.row[index], self.time[index])


def segments(dataset: Dataset, role: Role, signals: Sequence[str], kind: Kind = "motion") -> tuple[RowRange, ...]:
    """The parts of the dataset that have ``role`` for a network over ``signals``.

    Only recordings with all signals at the same time count. If none of them is ``select`` or ``held_out``, the ends of the
    ``fit`` recordings take the role. Poses without a role are ``fit``, since ingest assigns roles to motion only.

    Raises:
        ExcitationError: no ``fit`` recording has all signals.
    """
    usable = [r for r in dataset.of_kind(kind) if _measured(r, signals).any()]
    default: Role | None = "fit" if kind == "poses" else None
    roles = {r.name: dataset.splits.get(r.name, default) for r in usable}
    present = set(roles.values())
    if "fit" not in present:
        missing = [signal for signal in signals if not any(np.isfinite(r.values(signal)).any() for r in dataset.of_kind(kind))]
        found = f"no {kind} recording to fit that measures {', '.join(missing or signals)}"
        raise ExcitationError(
            f"dataset {dataset.reference}",
            found + ("" if missing else " at the same time"),
            f"at least one with all of {', '.join(signals)}",
        )
    if role in present and role != "fit":
        return tuple(RowRange(r, 0, len(r)) for r in usable if roles[r.name] == role)
    select, held_out = (
        0.0 if name in present else share for name, share in zip(("select", "held_out"), BLOCK_SHARES[kind], strict=True)
    )
    edges = {
        "fit": (0.0, 1.0 - select - held_out),
        "select": (1.0 - select - held_out, 1.0 - held_out),
        "held_out": (1.0 - held_out, 1.0),
    }
    low, high = edges[role]
    return tuple(_block(r, low, high, kind) for r in usable if roles[r.name] == "fit")


def gather(parts: Sequence[RowRange], signals: Sequence[str]) -> SignalRows:
    """All rows of ``parts`` with every signal, in order."""
    columns = []
    for part in parts:
        chosen = np.flatnonzero(_measured(part.recording, signals)[part.start : part.stop]) + part.start
        values = np.column_stack([part.recording.values(signal)[chosen] for signal in signals])
        columns.append((values, np.full(len(chosen), part.recording.name), chosen, part.recording.values("time")[chosen]))
    return SignalRows(tuple(signals), *map(np.concatenate, zip(*columns, strict=True)))


def joined(first: SignalRows, second: SignalRows) -> SignalRows:
    """The rows of both, in order."""
    columns = ([getattr(rows, key) for rows in (first, second)] for key in ("values", "recording", "row", "time"))
    return SignalRows(first.signals, *(np.concatenate(column) for column in columns))


def measures(dataset: Dataset, signals: Sequence[str], kind: Kind) -> bool:
    """Whether a recording of ``kind`` has a row with all signals."""
    return any(_measured(recording, signals).any() for recording in dataset.of_kind(kind))


def stratified_sample(values: Array, count: int, rng: np.random.Generator) -> npt.NDArray[np.intp]:
    """``count`` row numbers that cover the range of ``values`` (n,) as evenly as the data allow, sorted.

    Equal numbers of rows are drawn from :data:`BINS` equal bins; the shortfall of sparse bins is distributed over the others.
    """
    if count >= len(values):
        return np.arange(len(values))
    bins, width = BINS, max(float(np.ptp(values)), 1e-300)
    owner = np.minimum(((values - values.min()) / width * bins).astype(int), bins - 1)
    stock = np.bincount(owner, minlength=bins)
    quota = np.zeros(bins, dtype=int)
    while (left := count - int(quota.sum())) > 0:
        open_bins = np.flatnonzero(quota < stock)
        if left < len(open_bins):
            quota[rng.choice(open_bins, left, replace=False)] += 1
        else:
            quota[open_bins] = np.minimum(quota[open_bins] + left // len(open_bins), stock[open_bins])
    chosen = [rng.choice(np.flatnonzero(owner == number), quota[number], replace=False) for number in range(bins)]
    return np.sort(np.concatenate(chosen))


def evenly_spaced(length: int, count: int) -> Index:
    """At most ``count`` of the indices 0 … ``length`` − 1, evenly spaced."""
    return np.linspace(0, length - 1, min(length, count)).round().astype(np.int64)


def thin(rows: SignalRows, count: int) -> SignalRows:
    """At most ``count`` rows, evenly spaced in their order."""
    return rows if len(rows) <= count else rows.take(evenly_spaced(len(rows), count))


def _measured(recording: Recording, signals: Sequence[str]) -> npt.NDArray[np.bool_]:
    return np.asarray(np.all([np.isfinite(recording.values(signal)) for signal in signals], axis=0))


def _block(recording: Recording, low: float, high: float, kind: Kind) -> RowRange:
    """Rows from ``low`` to ``high`` (shares), without half of the guard at each cut."""
    n = len(recording)
    half = round(0.5 * GUARD_S * recording.rate_hz) if kind == "motion" else 0
    start = 0 if low == 0.0 else round(low * n) + half
    stop = n if high == 1.0 else round(high * n) - half
    return RowRange(recording, start, max(start, stop))
