"""End stops of an axis inside its described range: it stays at one place while the command pushes it further.

Nothing in the signals is wrong, but a simulation with a wider range runs on where the machine stops, and this error hides the
effects of the axis.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import stretches
from sysid.datasets.plausibility.finding import Cause, Evidence, Finding
from sysid.datasets.plausibility.words import interval, value
from sysid.datasets.quality.noise import table_noise
from sysid.datasets.recording import Recording
from sysid.machine import Axis, Machine
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Least command that pushes, beyond most dead-bands; least duration of a visit and of all [s]; least number of visits.
PUSHED, VISIT_S, TOTAL_S, VISITS = 0.3, 0.3, 1.0, 2
#: Places of a stop agree to this many standard deviations of the noise, or to this share of the range.
NOISES, SHARE = 6.0, 1e-3
#: Least distance to the described end, and least way back between two visits, as shares of the range.
INSIDE, AWAY = 0.01, 0.05
#: The nominal speed would leave the place by this multiple of its tolerance during the visits.
MOVED = 20.0
_NOISE_ROWS = 2**15


@dataclass(frozen=True)
class EndStop:
    """A place where an axis stays although the command pushes it further, and for how long."""

    place: float
    seconds: float
    visits: int


def end_stop_findings(recordings: Sequence[Recording], machine: Machine) -> Iterator[Finding]:
    """A notice for each valve axis that stops inside its stroke or limits."""
    for axis in machine.axes:
        low, high = axis.range
        if axis.actuation != "velocity" or not math.isfinite(high - low):
            continue
        stops = {side: _stop(recordings, axis, side) for side in (-1, 1)}
        inside = {side: stop for side, stop in stops.items() if stop is not None}
        if not inside:
            continue
        unit = machine.expected_unit(axis.driven)
        first, last = (inside[side].place if side in inside else end for side, end in ((-1, low), (1, high)))
        name = "stroke" if axis.drives == "cylinder" else "limits"
        evidence = tuple(
            Evidence(
                f"{axis.driven} stays at {value(stop.place, unit)} {stop.visits} times, {stop.seconds:.1f} s in all, although "
                f"{axis.name}.command pushes it further",
                f"motion up to {name} = {interval(low, high, unit)}",
            )
            for stop in inside.values()
        )
        remedy = f"Set {name} = {interval(first, last)} in machine.toml (or in the URDF, where it has them)"
        cause = Cause(f"`{name}` of axis", (axis.name,), "wider than the machine's end stops", remedy=remedy)
        yield Finding((f"{axis.name}:end_stop",), "notice", evidence, (cause,))


def _stop(recordings: Sequence[Recording], axis: Axis, side: int) -> EndStop | None:
    """The stop at one end of the motion; None without one, or at the described end."""
    low, high = axis.range
    width = high - low
    moving = [r for r in recordings if r.kind == "motion" and not np.isnan(r.values(axis.driven)).all()]
    if not moving:
        return None
    furthest = max(float(np.nanmax(y) if side > 0 else -np.nanmin(y)) for y in (r.values(axis.driven) for r in moving))
    noise = max(table_noise(r.values(axis.driven)[:_NOISE_ROWS], r.rate_hz) for r in moving)
    tolerance = max(NOISES * noise, SHARE * width)
    end = high if side > 0 else -low
    if end - furthest < max(INSIDE * width, tolerance):
        return None
    places, seconds, visits, would_move = list[Array](), 0.0, 0, 0.0
    for recording in moving:
        y, u = side * recording.values(axis.driven), side * recording.values(axis_signal(axis.name, "command"))
        rate = recording.rate_hz
        left = True
        starts, ends = stretches((y > furthest - 2.0 * tolerance) & (u > PUSHED))
        previous = 0
        for first, last in zip(starts, ends, strict=True):
            left = left or bool(np.nanmin(y[previous:first], initial=np.inf) < furthest - AWAY * width)
            previous = last
            settled = slice(first + round(VISIT_S * rate / 2), last)
            if last - first < VISIT_S * rate or np.ptp(y[settled]) > tolerance:
                continue
            visits += left
            left = False
            places.append(y[settled])
            seconds += (last - first) / rate
            would_move += axis.gain * float(np.sum(u[settled])) / rate
    if visits < VISITS or seconds < TOTAL_S or would_move < MOVED * tolerance:
        return None
    return EndStop(side * float(np.median(np.concatenate(places))), seconds, visits)
