"""Rows of the regression of a stage: its outputs averaged over short bins, recording by recording and signal by signal."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.compiled import kernel, summing
from sysid.datasets.recording import Recording
from sysid.gap.problem import Problem
from sysid.gap.stage_kind import StageKind
from sysid.plant.stretches import held
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Samples are averaged over this time [s]: short against lags and dead times, long enough that noise averages out.
BIN = 0.04
#: Length of the blocks of cross-validation [s]: long against the correlation time of a disturbance.
BLOCK = 5.0
#: Inputs and outputs of static stages are averaged over this time [s]; others keep their rate.
STATIC_SPAN = 0.1
#: Most bytes of residuals that a stage keeps.
KEPT = 64_000_000


@dataclass(frozen=True)
class Series:
    """The rows of one signal of one recording.

    Args:
        recording, signal: indices among the recordings and among the signals of the problem.
        rows: its rows of the regression.
        width: samples per row.
        time, step: of each row in its recording, and since the row before [s], (n,).
        present: whether enough samples of the row were measured and predicted, (n,).
        restart: where a run begins anew, (n,).
        measured: mean of the samples (n,), NaN where there is none.
        activity: mean speed of the output over the row, relative to the mean of the stage, (n,).
    """

    recording: int
    signal: int
    rows: slice
    width: int
    time: Array
    step: Array
    present: npt.NDArray[np.bool_]
    restart: npt.NDArray[np.bool_]
    measured: Array
    activity: Array


class StageRows:
    """Recordings of a stage as rows of a regression; predictions are averaged like measurements.

    Args:
        theta: vector of the plant under test: a row counts if it has a prediction.
        floor: noise floor of each output, (d,).
        averaged_out: variance of the outputs that averaging removes, in noise floors.

    ``present`` (rows,): rows with a measurement and a prediction; ``nominal`` (rows,): residual of ``theta``, zero elsewhere.
    """

    def __init__(
        self, problem: Problem, recordings: Sequence[Recording], theta: Array, floor: Array, averaged_out: float = 0.0
    ) -> None:
        self.problem, self.recordings, self.floor = problem, tuple(recordings), floor
        self.averaged_out = averaged_out
        series: list[Series] = []
        begin = 0
        for r, recording in enumerate(self.recordings):
            measured = problem.measured(recording)
            width = _width(problem, recording)
            known = measured - problem.predict(theta[None], recording)[0]
            means = bin_means(known[None], width)[0]
            count = len(means)
            time = _time(problem, recording, width, count)
            restart = _restarts(problem, recording, width, count)
            for k in range(measured.shape[1]):
                output = bin_means(measured[None, :, k : k + 1], width)[0, :, 0]
                series.append(
                    Series(
                        r,
                        k,
                        slice(begin, begin + count),
                        width,
                        time,
                        np.diff(time, prepend=time[:1] - (time[1] - time[0] if count > 1 else 1.0)),
                        ~np.isnan(means[:, k]) & ~np.isnan(output),
                        restart,
                        output,
                        _speed(output, time),
                    )
                )
                begin += count
        self.count = begin
        self.series = tuple(_normalised(series))
        self.spans = _spans(self.series, len(problem.signals))
        self.block = self._blocks()
        self.blocks = int(self.block.max(initial=-1)) + 1
        self.recording_of_block = np.zeros(self.blocks, dtype=np.int64)
        for s in self.series:
            self.recording_of_block[self.block[s.rows]] = s.recording
        self.theta = theta
        self._known = KnownResiduals()
        self.present = np.concatenate([s.present for s in self.series])
        self.nominal = np.zeros(begin)
        self.nominal = self.residuals(theta[None])[0]

    @property
    def measured_rows(self) -> int:
        """Number of rows with a measurement and a prediction."""
        return int(sum(s.present.sum() for s in self.series))

    def residuals(self, thetas: Array) -> Array:
        """(measured − predicted), averaged, (lanes, rows); zero where not measured.

        Where a parameter vector gives no prediction (a clock offset loses the ends), the residual is the nominal one.
        """
        out = np.empty((len(thetas), self.count))
        for here, part in self.residual_parts(thetas):
            out[:, here] = part
        return out

    def residual_parts(self, thetas: Array) -> Iterator[tuple[slice, Array]]:
        """:meth:`residuals` recording by recording: its rows, and the residuals there, (lanes, n)."""
        signals, names = len(self.problem.signals), [theta.tobytes() for theta in thetas]
        for r, recording in enumerate(self.recordings):
            series = self.series[r * signals : (r + 1) * signals]
            here = slice(series[0].rows.start, series[-1].rows.stop)
            known = self._known.of([(r, name) for name in names])
            new = {name: theta for name, theta in zip(names, thetas, strict=True) if (r, name) not in known}
            if new:
                measured = np.ascontiguousarray(self.problem.measured(recording))
                predicted = np.ascontiguousarray(self.problem.predict(np.array(list(new.values())), recording))
                out = np.empty((len(new), here.stop - here.start))
                _residuals(measured, predicted, series[0].width, self.present[here], self.nominal[here], out)
                known |= self._known.keep({(r, name): row for name, row in zip(new, out, strict=True)})
            yield here, np.stack([known[r, name] for name in names])

    def scaled(self, columns: Array) -> Array:
        """Columns (rows, m) in noise floors; zero where not measured."""
        out = np.zeros(columns.shape)
        for s in self.series:
            out[s.rows] = np.where(s.present[:, None], columns[s.rows] / self.floor[s.signal], 0.0)
        return out

    def products_in_floors(self, effects: Array, columns: npt.NDArray[np.floating]) -> Array:
        """Products (k, m) of ``effects`` (rows, k), in noise floors, with ``columns`` (rows, m), which are not."""
        total = np.zeros((effects.shape[1], columns.shape[1]))
        for s in self.series:
            _add_products(np.ascontiguousarray(effects[s.rows] / self.floor[s.signal]), columns[s.rows], total)
        return total

    def in_floors(self, columns: npt.NDArray[np.floating]) -> Array:
        """Root mean square of columns (rows, m) over the measured rows, in noise floors, (m,)."""
        total = np.zeros(columns.shape[1])
        for s in self.series:
            total += ((columns[s.rows][s.present] / self.floor[s.signal]) ** 2).sum(axis=0)
        return np.asarray(np.sqrt(total / max(self.measured_rows, 1)))

    def left(self, residual: Array) -> float:
        """Root mean square of a residual (rows,) over the samples of its rows, in noise floors, averaged-out noise included."""
        return float(np.sqrt(self.in_floors(residual[:, None])[0] ** 2 + self.averaged_out))

    def _blocks(self) -> npt.NDArray[np.int64]:
        """The block of every row; rows of all signals at one time share one, so do neighbouring poses."""
        block = np.zeros(self.count, dtype=np.int64)
        known: dict[int, tuple[int, npt.NDArray[np.int64]]] = {}
        used = 0
        for s in self.series:
            if s.recording not in known:
                span = s.time[-1] - s.time[0] if len(s.time) else 0.0
                parts = int(max(1, min(round(span / BLOCK), len(s.time) // 2)))
                known[s.recording] = used, (np.arange(len(s.time)) * parts) // max(len(s.time), 1)
                used += parts
            first, parts_of = known[s.recording]
            block[s.rows] = first + parts_of
        return block


class KnownResiduals:
    """The latest residuals of single recordings: a search compares the same sets of effects under several variances.

    They are known by the index of the recording and the bytes of the parameter vector.
    """

    def __init__(self) -> None:
        self._lock, self._rows, self._size = threading.Lock(), OrderedDict[tuple[int, bytes], Array](), 0

    def of(self, keys: Sequence[tuple[int, bytes]]) -> dict[tuple[int, bytes], Array]:
        """Those of ``keys`` that are known."""
        with self._lock:
            found = {key: self._rows[key] for key in keys if key in self._rows}
            for key in found:
                self._rows.move_to_end(key)
        return found

    def keep(self, rows: dict[tuple[int, bytes], Array]) -> dict[tuple[int, bytes], Array]:
        """Keep ``rows``, and return them; those that were not asked for the longest time leave."""
        with self._lock:
            for key, row in rows.items():
                self._rows[key] = row.copy()
                self._size += row.nbytes + len(key[1])
            while self._size > KEPT:
                (_, name), row = self._rows.popitem(last=False)
                self._size -= row.nbytes + len(name)
        return rows


@kernel
def _means(values, width, out):
    lanes, _, signals = values.shape
    for lane in range(lanes):
        for b in range(out.shape[1]):
            for k in range(signals):
                total = 0.0
                there = 0
                for i in range(b * width, (b + 1) * width):
                    x = values[lane, i, k]
                    if not np.isnan(x):
                        total += x
                        there += 1
                out[lane, b, k] = total / there if 2 * there > width else np.nan


@summing
def _add_products(effects, columns, out):
    for r in range(len(effects)):
        for i in range(effects.shape[1]):
            x = effects[r, i]
            for j in range(columns.shape[1]):
                out[i, j] += x * columns[r, j]


@kernel
def _residuals(measured, predicted, width, present, nominal, out):
    lanes, _, signals = predicted.shape
    bins = out.shape[1] // signals
    for lane in range(lanes):
        for k in range(signals):
            for b in range(bins):
                at = k * bins + b
                if not present[at]:
                    out[lane, at] = 0.0
                    continue
                total = 0.0
                there = 0
                for i in range(b * width, (b + 1) * width):
                    x = measured[i, k] - predicted[lane, i, k]
                    if not np.isnan(x):
                        total += x
                        there += 1
                out[lane, at] = total / there if 2 * there > width else nominal[at]


def bin_means(values: Array, width: int) -> Array:
    """Means over ``width`` samples, (lanes, n, d) → (lanes, n // width, d); NaN where fewer than half are present."""
    out = np.empty((values.shape[0], values.shape[1] // width, values.shape[2]))
    _means(np.ascontiguousarray(values), width, out)
    return out


def averaged(recording: Recording, kind: StageKind) -> Recording:
    """The recording averaged over the span of its kind of stage."""
    width = round((STATIC_SPAN if kind.static else 0.0) * recording.rate_hz)
    if recording.kind != "motion" or width < 2:
        return recording
    means = bin_means(recording.table.to_numpy(dtype=float)[None], width)[0]
    return replace(recording, table=pd.DataFrame(means, columns=recording.table.columns), rate_hz=recording.rate_hz / width)


def averaged_out(problem: Problem, recordings: Sequence[Recording], theta: Array, floor: Array, span: float) -> float:
    """Variance of the residual about a parabola within each ``span`` [s], less that of its mean; in noise floors, at most 1.

    From the recordings themselves, since the steps of a coarse sensor do not average out in slow motion.
    """
    total, count = 0.0, 0
    for recording in recordings:
        width = _width(problem, recording, max(span, BIN)) if recording.kind == "motion" else 1
        residual = problem.residual(theta, recording)
        bins = len(residual) // width
        if width < 3 or not bins:
            count += int((~np.isnan(residual)).sum())
            continue
        parts: Array = (residual / floor)[: bins * width].reshape(bins, width, -1)
        parts = np.moveaxis(parts, 1, 2).reshape(-1, width)
        parts = parts[~np.isnan(parts).any(axis=1)]
        degrees = min(3, width - 1)
        motion = np.vander(np.linspace(-1.0, 1.0, width), degrees)
        away = parts - parts @ (motion @ np.linalg.pinv(motion)).T
        total += float((away**2).sum()) / (width - degrees) * (width - 1)
        count += parts.size
    return min(total / max(count, 1), 1.0)


def _width(problem: Problem, recording: Recording, span: float = BIN) -> int:
    """Samples of a row: those of ``span`` [s]; of a force, which is decimated until its samples are independent, one."""
    return 1 if problem.force_filter is not None else max(1, round(span * problem.rate(recording)))


def _time(problem: Problem, recording: Recording, width: int, count: int) -> Array:
    rows = problem.rows(recording)[: count * width].reshape(count, width).mean(axis=1)
    # Static poses are independent: far apart in time.
    return np.asarray(rows * (1e3 if recording.kind == "poses" else 1.0 / recording.rate_hz))


def _restarts(problem: Problem, recording: Recording, width: int, count: int) -> npt.NDArray[np.bool_]:
    """Starts of the run of the stage: the first row, and the rows after gaps of its command."""
    found = np.zeros(count, dtype=np.bool_)
    found[:1] = True
    if problem.kind.commanded and recording.kind == "motion":
        command = recording.values(axis_signal(problem.target, "command"))
        for first, _ in held(command, recording.rate_hz)[1]:
            at = -(-int(first) // width)
            if at < count:
                found[at] = True
    return found


def _speed(output: Array, time: Array) -> Array:
    """Magnitude of the slope of a measured output, with gaps bridged."""
    there = ~np.isnan(output)
    if there.sum() < 3:
        return np.zeros(len(output))
    filled = np.interp(time, time[there], output[there])
    return np.asarray(np.abs(np.gradient(filled, time)), dtype=np.float64)


def _spans(series: Sequence[Series], signals: int) -> tuple[float, ...]:
    """Range of each output."""
    found = []
    for k in range(signals):
        joined = np.concatenate([s.measured for s in series if s.signal == k])
        found.append(float(np.nanmax(joined) - np.nanmin(joined)) if not np.isnan(joined).all() else 1.0)
    return tuple(found)


def _normalised(series: Sequence[Series]) -> list[Series]:
    """Activities relative to the root mean square of their signal over all recordings."""
    scales: dict[int, float] = {}
    for k in {s.signal for s in series}:
        joined = np.concatenate([s.activity for s in series if s.signal == k])
        scales[k] = float(np.sqrt(np.mean(joined**2))) if len(joined) else 0.0
    return [
        replace(s, activity=s.activity / scales[s.signal] if scales[s.signal] > 0.0 else np.ones(len(s.activity)))
        for s in series
    ]
