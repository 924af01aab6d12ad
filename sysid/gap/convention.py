"""The order of command and sample in the rows of the recordings, estimated where ``machine.toml`` does not state it.

Where a command acts for a whole period before the sample of its row is read, motion begins a row earlier. Each commanded axis
is therefore fitted with its dead time, its lags and its gain free, counted from such an early command: once with any dead time,
once with one of at least a period. If the first explains an axis, or most of what the second leaves, commands were written
before their samples were read. Else samples are taken as read before: other errors make an axis seem early too, such as a
dead-band that stops it. A dead time is uncertain by a period then, so that one within a period gets no name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset
from sysid.effects import first_order_lag, gain_error, input_delay, second_order_lag
from sysid.gap.candidates import Candidate, candidates_at
from sysid.gap.data import Data
from sysid.gap.fit import fit_candidates, spread_of
from sysid.gap.problem import Problem, Split, drive_problem
from sysid.gap.statement import CommandOrder
from sysid.gap.thresholds import BLOCK_NATS, EXPLAINED, PRICE
from sysid.machine import Convention
from sysid.plant import Plant, compile_plant
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: A dead time of a whole row, less the rounding with which whole rows are counted [rows].
ONE_ROW = 1.0 - 1e-6
#: What may explain when an axis begins to move, beside its dead time.
_BESIDE = (first_order_lag.EFFECT, second_order_lag.EFFECT, gain_error.EFFECT)


def with_order(plant: Plant, dataset: Dataset, split: Split, noise: Mapping[str, float]) -> tuple[Plant, CommandOrder | None]:
    """The plant with the convention of the recordings, and that convention; None where nothing depends on it."""
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
    found: Convention = "read_before_written"
    if any(_reacts_in_its_row(early, problem, split, noise) for problem in problems):
        found = "written_before_read"
    return early if found == early.machine.convention else plant, CommandOrder(stream, found, source, period)


def _measured(split: Split, *signals: str) -> bool:
    return any(all(not np.isnan(r.values(s)).all() for s in signals) for r in split.seen)


def _reacts_in_its_row(plant: Plant, problem: Problem, split: Split, noise: Mapping[str, float]) -> bool:
    """Whether an axis moves before the row after its command, whatever its dead time, lags and gain are."""
    theta, period = plant.vector(), ONE_ROW / split.seen[0].rate_hz
    if period >= input_delay.LONGEST:
        return False
    known = candidates_at(plant, theta, problem.stages, problem.targets)
    forms = {c.key: c for c in reversed(known) if c.effect in (input_delay.EFFECT, *_BESIDE)}  # the simplest form of each
    candidates = tuple(forms.values())
    data = Data(problem, split.seen, np.array([max(noise.get(problem.signals[0], 0.0), 1e-12)]))
    starts = _one_by_one(candidates)
    free = fit_candidates(data, theta, candidates, starts)
    at = next(c for c in candidates if c.effect is input_delay.EFFECT)
    if free.values_of(at)[0] > 0.5 * period:  # nearer to the other order
        return False
    offered = tuple(_at_least(c, period) if c is at else c for c in candidates)
    later = fit_candidates(data, theta, offered, starts)
    rest, more = (spread_of(data.residuals(fit.theta[None])) for fit in (free, later))
    explains = rest < EXPLAINED or rest**2 * PRICE < more**2
    return explains and free.log_likelihood - later.log_likelihood > BLOCK_NATS


def _one_by_one(candidates: Sequence[Candidate]) -> list[Array]:
    """The nominal values, and the start values of each candidate beside the nominal ones of the others."""
    nominal = [np.array([u.nominal for u in c.unknowns]) for c in candidates]
    starts = [np.concatenate(nominal)]
    for k, candidate in enumerate(candidates):
        starts += [np.concatenate([*nominal[:k], np.array(row), *nominal[k + 1 :]]) for row in candidate.starts]
    return starts


def _at_least(candidate: Candidate, delay: float) -> Candidate:
    (unknown,) = candidate.unknowns
    return replace(candidate, unknowns=(replace(unknown, bounds=(delay, unknown.bounds[1])),))
