"""What the clocks of a dataset leave open: the order of command and sample in a row, and offsets between streams.

Where a command acts for a whole period before the sample of its row is read, motion begins a row earlier. Where
``machine.toml`` does not state the order, each commanded axis is therefore fitted with its dead time, its lags and its gain
free, counted from such an early command: once with any dead time, once with one of at least a period. If the first explains an
axis, or most of what the second leaves, commands were written before their samples were read. Else samples are taken as read
before: other errors make an axis seem early too, such as a dead-band that stops it. A dead time is uncertain by a period then,
so that one within a period gets no name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import PurePath
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset
from sysid.effects import first_order_lag, gain_error, input_delay, second_order_lag
from sysid.gap.candidates import candidates_at
from sysid.gap.data import Data
from sysid.gap.fit import ROUGH, fit_candidates, spread_of
from sysid.gap.problem import Problem, Split, drive_problem
from sysid.gap.statement import CommandOrder
from sysid.gap.thresholds import BLOCK_NATS, PRICE, STANDARD_ERRORS, at_floor
from sysid.machine import Convention
from sysid.plant import Plant, compile_plant
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: A dead time of a whole row, less the rounding with which whole rows are counted [rows].
ONE_ROW = 1.0 - 1e-6
#: What may explain when an axis begins to move.
_LATE = (input_delay.EFFECT, first_order_lag.EFFECT, second_order_lag.EFFECT, gain_error.EFFECT)
#: Standard errors in a 95 % interval.
NORMAL95 = 1.96


def with_order(plant: Plant, dataset: Dataset, split: Split, noise: Mapping[str, float]) -> tuple[Plant, CommandOrder | None]:
    """The plant with the convention of the recordings, and that convention; None where nothing depends on it.

    Args:
        noise: standard deviation by signal [SI].
    """
    machine = plant.machine
    stream = next((name for name, signals in dataset.streams.items() if any(s.endswith(".command") for s in signals)), "")
    source: Literal["stated", "estimated"] = "estimated" if dataset.machine.convention is None else "stated"
    period = 1.0 / machine.rate_hz
    if machine.convention is not None:
        return plant, CommandOrder(stream, machine.convention, source, period if source == "estimated" else 0.0)
    early = replace(plant, machine=replace(machine, convention="written_before_read"), reference="")
    model = compile_plant(early)
    problems = [
        drive_problem(model, axis)
        for axis in machine.axes
        if axis.actuation != "force" and _measured(split, axis_signal(axis.name, "command"), axis.driven)
    ]
    if not problems:
        return plant, None
    is_early = any(_reacts_in_its_row(early, problem, split, noise) for problem in problems)
    found: Convention = "written_before_read" if is_early else "read_before_written"
    return early if is_early else plant, CommandOrder(stream, found, source, period)


def _measured(split: Split, *signals: str) -> bool:
    return any(all(not np.isnan(r.values(s)).all() for s in signals) for r in split.seen)


def _reacts_in_its_row(plant: Plant, problem: Problem, split: Split, noise: Mapping[str, float]) -> bool:
    """Whether an axis moves before the row after its command, whatever its dead time, lags and gain are."""
    theta, period = plant.vector(), ONE_ROW / split.seen[0].rate_hz
    if period >= input_delay.LONGEST:
        return False
    known = candidates_at(plant, theta, problem.kind.stages, problem.targets)
    candidates = tuple({c.key: c for c in reversed(known) if c.effect in _LATE}.values())  # the simplest form of each
    data = Data(problem, split.seen, np.array([max(noise.get(problem.signals[0], 0.0), 1e-12)]))
    # The nominal values, and the start values of each candidate beside the nominal ones of the others.
    nominal = [np.array([u.nominal for u in c.unknowns]) for c in candidates]
    starts = [np.concatenate(nominal)]
    for k, candidate in enumerate(candidates):
        starts += [np.concatenate([*nominal[:k], np.array(row), *nominal[k + 1 :]]) for row in candidate.starts]
    rough = fit_candidates(data, theta, candidates, starts, ROUGH)
    delay = next(c for c in candidates if c.effect is input_delay.EFFECT)
    if rough.values_of(delay)[0] > 0.5 * period:  # nearer to the other order
        return False
    free = fit_candidates(data, theta, candidates, [rough.values])
    (unknown,) = delay.unknowns
    at_least = replace(delay, unknowns=(replace(unknown, bounds=(period, unknown.bounds[1])),))
    later = fit_candidates(data, theta, tuple(at_least if c is delay else c for c in candidates), starts)
    rest, more = (spread_of(data.residuals(fit.theta[None])) for fit in (free, later))
    explains = at_floor(rest) or rest**2 * PRICE < more**2
    return explains and free.log_likelihood - later.log_likelihood > BLOCK_NATS


def open_offset(dataset: Dataset, stream: str) -> float:
    """Half-width [s] of a clock offset of ``stream`` that its clock records leave open: within it an offset is no effect.

    Two standard errors of the offset (root mean square over the recordings that were aligned on their motion), plus half a
    sample, the resolution of a stamp. For a stream that was not aligned, half a sample.

    Args:
        stream: stem of its file, as in ``dataset.streams`` and as the target of ``clock_offset``.
    """
    intervals = [
        record.offset_interval95
        for record in dataset.clocks
        if record.applied and PurePath(record.stream).stem == stream and math.isfinite(record.residual_rms)
    ]
    known = [half for low, high in intervals if math.isfinite(half := (high - low) / 2.0)]
    error = math.sqrt(sum(half**2 for half in known) / len(known)) / NORMAL95 if known else 0.0
    return STANDARD_ERRORS * error + 0.5 / _rate(dataset, stream)


def _rate(dataset: Dataset, stream: str) -> float:
    """Sample rate of the tables, or of the stream where it is lower [Hz]."""
    rates = [recording.rate_hz for recording in dataset.of_kind("motion")] or [dataset.machine.rate_hz]
    for channels in dataset.quality.get("streams", {}).values():
        for key, figures in channels.items():
            source = key.rpartition("/")[0]
            if PurePath(source).stem == stream and figures.get("rate_hz"):
                rates.append(float(figures["rate_hz"]))
    return min(rates)
