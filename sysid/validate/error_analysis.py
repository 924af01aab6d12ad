"""Error profiles against position, speed and direction; errors over two variables at a time (two joints, or a joint and its
speed) in a table of bins with their counts; and spikes with their nearest cause. Bins of a variable, and the share of an
error's variance that they explain, are also those of the maps of the gap.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset
from sysid.names import uncut_name
from sysid.networks.split import SignalRows

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
#: ``range``: equal bins; ``signed``: symmetric bins, one of which contains zero; ``sign``: a direction, −1, 0 or +1.
Cut = Literal["range", "signed", "sign"]

#: Number of bins of a signed variable (odd: one of them contains zero), and of others.
SIGNED_BINS, BINS = 31, 20
#: Speeds are differences over this time [s]: long against sensor noise, short against a stroke.
SPEED_WINDOW = 0.2
#: Below this share of the largest speed an axis counts as at rest.
STANDING = 0.02


def edges_of(values: Array, cut: Cut = "range", bins: int | None = None) -> Array | None:
    """Edges of the bins, (bins + 1,); None where ``values`` (n,) do not vary.

    Values beyond the 0.5 and 99.5 % percentiles belong to the bins at the ends.
    """
    if cut == "sign":
        return np.array([-1.5, -0.5, 0.5, 1.5])
    low, high = np.quantile(values, (0.005, 0.995))
    if cut == "signed":
        low, high = -max(abs(low), abs(high)), max(abs(low), abs(high))
    if not high - low > 1e-9 * max(abs(low), abs(high), 1e-12):
        return None
    return np.linspace(low, high, (bins or (SIGNED_BINS if cut == "signed" else BINS)) + 1)


def places_in(edges: Array, values: Array) -> Index:
    """Index of the bin of every value, (n,)."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def explained(error: Array, place: Index, count: Index) -> float:
    """Share of the variance of the error that the means of the bins explain (correlation ratio η², 0 … 1)."""
    sums = np.bincount(place, weights=error, minlength=len(count))
    total = float(np.sum((error - error.mean()) ** 2))
    between = float(np.sum(sums**2 / np.maximum(count, 1)) - error.sum() ** 2 / len(error))
    return min(max(between / total, 0.0), 1.0) if total > 0.0 else 0.0


def speed_of(values: Array, rate_hz: float, window: float = SPEED_WINDOW) -> Array:
    """Central differences (n, …) over ``window`` [s], NaN at the ends and beside gaps."""
    half = max(1, round(0.5 * window * rate_hz))
    out = np.full(values.shape, np.nan)
    if len(values) > 2 * half:
        out[half:-half] = (values[2 * half :] - values[: -2 * half]) * (rate_hz / (2 * half))
    return out


def direction_of(speed: Array) -> Array:
    """−1, 0 (at rest) or +1; NaN where the speed is NaN."""
    least = STANDING * float(np.nanmax(np.abs(speed), initial=0.0))
    return np.where(np.isnan(speed), np.nan, np.where(np.abs(speed) > least, np.sign(speed), 0.0))


def per_second(unit: str) -> str:
    return f"{unit}/s" if unit != "1" else "1/s"


#: Signal → (lower, upper) end [SI].
Ranges = Mapping[str, tuple[float, float]]

#: A spike is an error beyond this many robust standard deviations (1.4826 × median absolute deviation).
SPIKE_SIGMAS = 6.0
#: Largest number of spikes of an output.
MAX_SPIKES = 10
#: Spikes closer together than this are one [s].
SPIKE_APART_S = 0.5
#: Causes are searched within this time [s], and within this share of a range from its ends.
CAUSE_WITHIN_S = 0.3
END_SHARE = 0.02
#: Half-width of the difference that estimates a speed [s].
SPEED_HALF_S = 0.05
#: Below this share of its 99th percentile a speed counts as at rest.
STILL_SHARE = 0.05


@dataclass(frozen=True)
class Profile:
    """Error against one variable, in bins.

    Args:
        variable: ``boom.cylinder``, ``speed of boom.cylinder``, ``direction of boom.cylinder``.
        unit: of the edges.
        edges: (bins + 1,); for a direction the bins are negative, still and positive.
        count, rmse, bias, p95: (bins,) each, NaN in an empty bin, in the unit of the output.
    """

    variable: str
    unit: str
    edges: tuple[float, ...]
    count: tuple[int, ...]
    rmse: tuple[float, ...]
    bias: tuple[float, ...]
    p95: tuple[float, ...]


@dataclass(frozen=True)
class Spike:
    """One error beyond :data:`SPIKE_SIGMAS`.

    Args:
        recording, time: of its peak [s since the recording's start].
        error: predicted − truth at its peak.
        sigmas: its size in robust standard deviations.
        cause: the nearest cause, or ``unexplained``.
    """

    recording: str
    time: float
    error: float
    sigmas: float
    cause: str


def profile(errors: Array, against: Array, variable: str, unit: str, bins: int = 12) -> Profile:
    """Error statistics in ``bins`` equal bins of ``against`` (n,); rows where it is NaN are left out."""
    known = np.isfinite(against)
    low, high = float(against[known].min()), float(against[known].max())
    edges = np.linspace(low, high if high > low else low + 1e-12, bins + 1)
    return _binned(errors[known], np.clip(np.digitize(against[known], edges) - 1, 0, bins - 1), edges, variable, unit)


def speed_profiles(errors: Array, speed: Array, signal: str, unit: str) -> list[Profile]:
    """Error statistics over the magnitude and the direction of the ``speed`` of ``signal``."""
    magnitude = profile(errors, np.abs(speed), f"speed of {signal}", unit)
    return [magnitude, direction_profile(errors, speed, f"direction of {signal}", unit)]


def direction_profile(errors: Array, speed: Array, variable: str, unit: str) -> Profile:
    """Error statistics of negative motion, rest and positive motion."""
    known = np.isfinite(speed)
    limit = STILL_SHARE * float(np.percentile(np.abs(speed[known]), 99))
    top = max(float(np.abs(speed[known]).max()), 2.0 * limit, 1e-12)
    owner = np.where(speed[known] < -limit, 0, np.where(speed[known] > limit, 2, 1))
    return _binned(errors[known], owner, np.array([-top, -limit, limit, top]), variable, unit)


def _binned(errors: Array, owner: npt.NDArray[np.intp], edges: Array, variable: str, unit: str) -> Profile:
    groups = [errors[owner == number] for number in range(len(edges) - 1)]
    return Profile(
        variable=variable,
        unit=unit,
        edges=tuple(edges.tolist()),
        count=tuple(len(group) for group in groups),
        rmse=tuple(float(np.sqrt(np.mean(group**2))) if len(group) else float("nan") for group in groups),
        bias=tuple(float(np.mean(group)) if len(group) else float("nan") for group in groups),
        p95=tuple(float(np.percentile(np.abs(group), 95)) if len(group) else float("nan") for group in groups),
    )


def speeds(dataset: Dataset, rows: SignalRows, signal: str) -> Array:
    """Rate of change of ``signal`` at ``rows`` by a central difference, (n,) [SI/s]; NaN beside gaps and at the ends."""
    result = np.full(len(rows), np.nan)
    for name in np.unique(rows.recording):
        recording = dataset.recording(str(name))
        rate = speed_of(recording.values(signal), recording.rate_hz, 2.0 * SPEED_HALF_S)
        mine = rows.recording == name
        result[mine] = rate[rows.row[mine]]
    return result


def spikes(
    dataset: Dataset,
    rows: SignalRows,
    errors: Array,
    ends: Ranges,
    fitted: Ranges,
    is_motion: bool,
) -> tuple[Spike, ...]:
    """The :data:`MAX_SPIKES` largest spikes of ``errors`` (n,), each with the nearest cause.

    Args:
        rows: of the errors.
        ends: signals whose end stops and reversals are possible causes.
        fitted: inputs of the network → fitted range; outside it, it extrapolates.
        is_motion: rows are consecutive in time; else only ends of ranges are possible causes.
    """
    centre = float(np.median(errors))
    sigma = 1.4826 * float(np.median(np.abs(errors - centre)))
    if sigma == 0.0:
        return ()
    size = np.abs(errors - centre) / sigma
    found: list[Spike] = []
    taken: list[tuple[str, float]] = []
    for position in np.argsort(size)[::-1]:
        if size[position] < SPIKE_SIGMAS or len(found) == MAX_SPIKES:
            break
        name, time = str(rows.recording[position]), float(rows.time[position])
        if is_motion and any(name == other and abs(time - moment) < SPIKE_APART_S for other, moment in taken):
            continue
        taken.append((name, time))
        cause = _cause(dataset, name, int(rows.row[position]), rows.signals, ends, fitted, is_motion)
        found.append(Spike(name, time, float(errors[position]), float(size[position]), cause))
    return tuple(found)


def _cause(
    dataset: Dataset, name: str, row: int, signals: tuple[str, ...], ends: Ranges, fitted: Ranges, is_motion: bool
) -> str:
    recording = dataset.recording(name)
    for signal, (low, high) in fitted.items():
        value = float(recording.values(signal)[row])
        if not low <= value <= high:
            return f"{signal} {'below' if value < low else 'above'} the fitted range"
    reach = round(CAUSE_WITHIN_S * recording.rate_hz) if is_motion else 0
    near = slice(max(0, row - reach), row + reach + 1)
    for signal, (low, high) in ends.items():
        values = recording.values(signal)[near]
        known = values[np.isfinite(values)]
        margin = END_SHARE * (high - low)
        if np.isfinite(margin) and len(known):
            if known.min() < low + margin:
                return f"lower end of {signal}"
            if known.max() > high - margin:
                return f"upper end of {signal}"
    if not is_motion:
        return "unexplained"
    missing = [signal for signal in signals if np.isnan(recording.values(signal)[near]).any()]
    if missing:
        return f"edge of a gap in {missing[0]}"
    if row < reach or row + reach >= len(recording):
        return "end of the recording"
    clocks = [record for record in dataset.clocks if record.recording in (name, uncut_name(name))]
    now = float(recording.values("time")[row])
    for record in clocks:
        # Later pieces of a stream start at a clock reset; their offset is that time on the machine's clock.
        if record.recording == name and record.reason.startswith("piece ") and abs(record.offset_s - now) < CAUSE_WITHIN_S:
            return f"clock of {record.stream} set"
    for signal in ends:
        steps = np.diff(recording.values(signal)[near])
        if _reverses(steps):
            return f"reversal of {signal}"
    for record in clocks:
        carried = dataset.streams.get(record.stream) or dataset.streams.get(record.stream.rpartition(".")[0], ())
        if not record.applied and any(signal in carried for signal in signals):
            return f"clock of {record.stream} not aligned"
    return "unexplained"


def _reverses(steps: Array) -> bool:
    """Whether the signal reverses: it travels both ways, each a substantial part of the whole."""
    up, down = float(steps[steps > 0].sum()), float(-steps[steps < 0].sum())
    travel = np.cumsum(steps)
    turn = float(max(travel.max(), 0.0) - min(travel.min(), 0.0)) - abs(float(travel[-1]))
    return turn > 0.1 * (up + down) and min(up, down) > 0.2 * max(up, down)


#: Largest number of bins per variable, and least average number of rows per bin.
MAX_BINS, ROWS_A_BIN = 10, 6
#: Largest number of maps of an output: those that explain most.
MAX_MAPS = 6


@dataclass(frozen=True)
class MapAxis:
    """One variable of a map: its unit, its values (n,) with NaN where unknown, and its kind of bins."""

    name: str
    unit: str
    values: Array
    cut: Cut = "range"


@dataclass(frozen=True)
class ErrorMap:
    """Errors of one output in bins of two variables.

    Args:
        over, units: the two variables, and their units.
        edges: of the bins of each, (a + 1,) and (b + 1,).
        count, rmse, bias: a rows of b bins; NaN in an empty bin, in the unit of the output.
        explains: share of the error's variance that the means of the bins explain, 0 … 1.
    """

    over: tuple[str, str]
    units: tuple[str, str]
    edges: tuple[tuple[float, ...], tuple[float, ...]]
    count: tuple[tuple[int, ...], ...]
    rmse: tuple[tuple[float, ...], ...]
    bias: tuple[tuple[float, ...], ...]
    explains: float

    @property
    def worst(self) -> tuple[int, int]:
        """The bin with the largest RMSE among those with several rows."""
        sizes = np.where(np.array(self.count) >= 3, np.array(self.rmse), -1.0)
        row, column = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
        return int(row), int(column)


def error_maps(errors: Array, pairs: Iterable[tuple[MapAxis, MapAxis]]) -> tuple[ErrorMap, ...]:
    """Maps of ``errors`` (n,) over pairs of variables, those that explain most first, at most :data:`MAX_MAPS`; a constant
    variable has no map.
    """
    found = [item for first, second in pairs if (item := error_map(errors, first, second)) is not None]
    return tuple(sorted(found, key=lambda item: -item.explains)[:MAX_MAPS])


def error_map(errors: Array, first: MapAxis, second: MapAxis) -> ErrorMap | None:
    """Errors over two variables; None where one of them is constant or too few rows have both."""
    there = np.isfinite(first.values) & np.isfinite(second.values)
    bins = min(MAX_BINS, int(np.sqrt(there.sum() / ROWS_A_BIN)))
    if bins < 2:
        return None
    edges = [edges_of(axis.values[there], axis.cut, bins) for axis in (first, second)]
    if edges[0] is None or edges[1] is None:
        return None
    shape = (len(edges[0]) - 1, len(edges[1]) - 1)
    place = places_in(edges[0], first.values[there]) * shape[1] + places_in(edges[1], second.values[there])
    own = errors[there]
    count = np.bincount(place, minlength=shape[0] * shape[1])
    filled = np.where(count > 0, count, np.nan)
    bias = np.bincount(place, weights=own, minlength=len(count)) / filled
    rmse = np.sqrt(np.bincount(place, weights=own**2, minlength=len(count)) / filled)
    return ErrorMap(
        over=(first.name, second.name),
        units=(first.unit, second.unit),
        edges=(tuple(edges[0].tolist()), tuple(edges[1].tolist())),
        count=tuple(map(tuple, count.reshape(shape).tolist())),
        rmse=tuple(map(tuple, rmse.reshape(shape).tolist())),
        bias=tuple(map(tuple, bias.reshape(shape).tolist())),
        explains=explained(own, place, count),
    )
