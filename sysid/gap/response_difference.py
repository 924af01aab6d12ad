"""Where the responses of a simulation, looked at without a model, differ from those of the recordings.

What an engineer reads off the recordings (:mod:`sysid.datasets.quality.responses`) is read off the simulated motion as well. A
verdict beside which they differ has not found what they show.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import pandas as pd

from sysid.datasets.quality.responses import AxisResponse, Direction, responses_in
from sysid.datasets.recording import Recording
from sysid.machine import Machine

#: Speeds at full command that differ by less than this share are alike: they are medians over a few commands.
ALIKE = 0.1


@dataclass(frozen=True)
class ResponseDifference:
    """One figure of an axis in which recordings and simulation differ.

    Args:
        quantity: ``delay`` between command and motion [s], the command at which motion ``begins``, speed at ``full`` command.
        side: direction of the command; empty for a delay.
        recorded, simulated: lowest and highest value that each shows; NaN above where no command moves it.
        unit: SI unit.
    """

    axis: str
    quantity: Literal["delay", "begins", "full"]
    side: Literal["", "positive", "negative"]
    recorded: tuple[float, float]
    simulated: tuple[float, float]
    unit: str


def response_differences(
    recordings: Sequence[Recording], runs: Sequence[pd.DataFrame], machine: Machine, units: Mapping[str, str]
) -> tuple[ResponseDifference, ...]:
    """The differences between ``recordings`` of motion and their simulated ``runs`` (columns = signals, same rows)."""
    simulated = []
    for recording, run in zip(recordings, runs, strict=True):
        driven = [axis.driven for axis in machine.axes if axis.driven in run.columns and axis.driven in recording.signals]
        values = {signal: run[signal].where(recording.table[signal].notna().to_numpy()).to_numpy() for signal in driven}
        simulated.append(Recording(recording.name, recording.table.assign(**values), recording.rate_hz))
    found = {response.axis: response for response in responses_in(simulated, machine, units)}
    measured = responses_in(recordings, machine, units)
    row = 1.0 / min((recording.rate_hz for recording in recordings), default=1.0)
    return tuple(item for response in measured for item in _between(response, found[response.axis], row))


def _between(recorded: AxisResponse, simulated: AxisResponse, row: float) -> Iterator[ResponseDifference]:
    def different(quantity: Literal["begins", "full"], side: Literal["positive", "negative"], unit: str,
                  one: tuple[float, float], other: tuple[float, float]) -> ResponseDifference:  # fmt: skip
        return ResponseDifference(recorded.axis, quantity, side, one, other, unit)

    ours, theirs = recorded.delay95, simulated.delay95
    if _apart(ours, theirs) and abs(recorded.delay - simulated.delay) > row:
        yield ResponseDifference(recorded.axis, "delay", "", ours, theirs, "s")
    sides: tuple[tuple[Literal["positive", "negative"], Direction | None, Direction | None], ...] = (
        ("positive", recorded.positive, simulated.positive), ("negative", recorded.negative, simulated.negative)
    )  # fmt: skip
    for side, one, other in sides:
        if one is None or other is None:
            continue
        if _apart(one.begins, other.begins):
            yield different("begins", side, "1", one.begins, other.begins)
        if _apart(one.full95, other.full95) and abs(one.full - other.full) > ALIKE * max(one.full, other.full):
            yield different("full", side, f"{recorded.unit}/s", one.full95, other.full95)


def _apart(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether two ranges have nothing in common; false where either is unknown."""
    return one[0] > other[1] or other[0] > one[1]
