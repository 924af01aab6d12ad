"""Still phases with their posture and length, which excite leakage and sag and show the noise at rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import known, stretches
from sysid.datasets.quality.coverage import Span
from sysid.datasets.quality.noise import table_noise
from sysid.datasets.quality.use import SLOPE_S, SLOW, Scale, level_of, speed_of
from sysid.datasets.recording import Recording
from sysid.machine import Machine
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Least length of a phase [s].
LEAST_S = 1.0
#: An axis is still below this many standard deviations of the noise of its speed (exceeded by one in 10⁹ samples), or below the
#: limit of slow motion.
STILL = 6.0
#: Postures differ where an axis differs by this share of its range.
APART = 0.1


@dataclass(frozen=True)
class Rest:
    """A phase without command and motion; ``posture``: axis → median [SI], of the axes measured in it."""

    recording: str
    from_s: float
    to_s: float
    posture: Mapping[str, float]

    @property
    def seconds(self) -> float:
        return self.to_s - self.from_s


def rests_of(recording: Recording, machine: Machine, spans: Sequence[Span], scales: Mapping[str, Scale]) -> list[Rest]:
    """Still phases of a recording of motion. Servos and forces may hold a position, so only the motion of those axes counts."""
    still, known = np.ones(len(recording), dtype=bool), np.zeros(len(recording), dtype=bool)
    for axis in machine.axes:
        if axis.actuation == "velocity":
            still &= level_of(recording.values(axis_signal(axis.name, "command"))) == 0
    for span in spans:
        values = recording.values(span.signal)
        noise = table_noise(values, recording.rate_hz)
        top = scales[span.axis].top_speed if span.axis in scales else 0.0
        limit = max(SLOW[0] * top, STILL * np.sqrt(2.0) * noise / SLOPE_S, 1e-12)
        speed = np.abs(speed_of(values, recording.rate_hz))
        still &= ~(speed > limit)
        known |= ~np.isnan(speed)
    time = recording.values("time")
    found = []
    for first, last in zip(*stretches(still & known), strict=True):
        if last - first < LEAST_S * recording.rate_hz:
            continue
        parts = {span.axis: recording.values(span.signal)[first:last] for span in spans}
        posture = {name: float(np.nanmedian(v)) for name, v in parts.items() if not np.isnan(v).all()}
        found.append(Rest(recording.name, float(time[first]), float(time[last - 1]), posture))
    return found


def postures(rests: Sequence[Rest], spans: Sequence[Span]) -> tuple[Rest, ...]:
    """The longest phase of each distinct posture (:data:`APART`), the longest first."""
    kept: list[Rest] = []
    for rest in sorted(rests, key=lambda rest: -rest.seconds):
        if all(_apart(rest, other, spans) for other in kept):
            kept.append(rest)
    return tuple(kept)


def _apart(one: Rest, other: Rest, spans: Sequence[Span]) -> bool:
    return any(
        abs(one.posture[s.axis] - other.posture[s.axis]) > APART * (s.high - s.low)
        for s in spans
        if s.axis in one.posture and s.axis in other.posture
    )


def noise_at_rest(recordings: Mapping[str, Recording], rests: Sequence[Rest], signal: str) -> float | None:
    """Median over still phases of the standard deviation of a signal about a straight line; None without such phases."""
    found = []
    for rest in rests:
        recording = recordings[rest.recording]
        first, last = np.searchsorted(recording.values("time"), (rest.from_s, rest.to_s))
        inside = known(recording.values(signal)[first : last + 1])
        if len(inside) >= LEAST_S * recording.rate_hz / 2.0 and len(inside) > 10:
            rows = np.linspace(-1.0, 1.0, len(inside))
            left = inside - inside.mean()
            left -= np.multiply(rows, (rows @ left) / (rows @ rows), out=rows)
            found.append(float(np.sqrt((left @ left) / (len(left) - 2))))
    return float(np.median(found)) if found else None
