"""Simulated recordings for the study of clocks: joint motion, two devices that measure it, and their faults."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from sysid.datasets.channel import Channel, in_order
from sysid.datasets.clocks.records import RecordingClocks
from sysid.datasets.clocks.set_clocks import continued

Array = npt.NDArray[np.float64]

#: First stamp of the machine, and of the other device, which counts from its own start [ns].
EPOCH, OTHER = 1_700_000_000_000_000_000, 5_000_000_000
MACHINE_HZ, OTHER_HZ = 100.0, 120.0
#: Noise of both devices in standard deviations of the motion.
NOISE = 0.02
KINDS = ("plain", "gaps", "jitter", "outliers", "reset")


@dataclass(frozen=True)
class SimulatedRecording:
    """A recording and the truth about its clock.

    Args:
        clocked: machine: boom.cylinder, slew.joint; other device: boom.joint, slew.joint.
        stream_s: of the other device's samples on its own clock, carried on where it was set back (n,) [s].
        machine_s: machine's time, from its first sample, when the other clock showed them (n,) [s].
        skew_ppm: true, without resets.
        reset_s: machine time at which the clock was set; NaN without.
        reset_by: by how much its stamps then stepped, beyond the time that passed [s].
        pieces: how many the stream has, once stamps that were set back have been carried on.
    """

    clocks: RecordingClocks
    stream_s: Array
    machine_s: Array
    skew_ppm: float
    reset_s: float = float("nan")
    reset_by: float = 0.0
    pieces: int = 1


def motion(seconds: float, hertz: float, rng: np.random.Generator) -> CubicSpline:
    """Random motion of unit size below ``hertz``, as a curve from −10 s to ``seconds`` + 10 s."""
    rate = 50.0 * hertz
    time = np.arange(-10.0, seconds + 10.0, 1.0 / rate)
    values = sosfiltfilt(butter(2, hertz, fs=rate, output="sos"), rng.normal(size=len(time)))
    return CubicSpline(time, values / values.std())


def linkage(x: Array) -> Array:
    """A joint that its cylinder moves, the other way round and not in proportion."""
    return np.asarray(-1.7 * np.arctan(0.4 * x) + 0.3)


def simulated(
    seconds: float, hertz: float, kind: str, seed: int, skew_ppm: float | None = None, noise: float = NOISE
) -> SimulatedRecording:
    """One recording: ``t_machine = t_true``, the other device's clock ``t·(1 + skew) + offset = t_true`` until it is set."""
    rng = np.random.default_rng([seed, round(10 * seconds), round(10 * hertz), KINDS.index(kind)])
    skew = 1e-6 * (rng.uniform(-100.0, 100.0) if skew_ppm is None else skew_ppm)
    offset = rng.uniform(0.0, 2.0)  # the machine's log began first
    curves = {"boom": motion(seconds, hertz, rng), "slew": motion(seconds, hertz, rng)}
    at_machine = np.arange(0.0, seconds, 1.0 / MACHINE_HZ)
    stream = np.arange(0.0, seconds - offset, 1.0 / OTHER_HZ)
    truth = stream * (1.0 + skew) + offset
    reset_s, reset_by = float("nan"), 0.0
    if kind == "reset":
        stream, truth, reset_s, reset_by = _set(stream, truth, seconds, rng)
    x = {"boom.cylinder": curves["boom"](at_machine), "slew.joint": curves["slew"](at_machine)}
    y = {"boom.joint": linkage(curves["boom"](truth)), "slew.joint": curves["slew"](truth)}
    x = {name: values + noise * rng.normal(size=len(values)) for name, values in x.items()}
    y = {name: values + noise * rng.normal(size=len(values)) for name, values in y.items()}
    machine_stamps, stamps = at_machine, stream
    if kind == "gaps":
        for name in y:
            y[name] = _gaps(truth, y[name], 2.0 * seconds / 60.0, rng)
        for name in x:
            x[name] = _gaps(at_machine, x[name], 0.5 * seconds / 60.0, rng)
    elif kind == "jitter":
        machine_stamps = at_machine + 1e-3 * rng.uniform(-1.0, 1.0, len(at_machine))
        stamps = stream + 2e-3 * rng.uniform(-1.0, 1.0, len(stream))
    elif kind == "outliers":
        for name in y:
            y[name] = _outliers(truth, y[name], rng)
    channels = [
        Channel(name, "log.mcap", "machine", _stamps(machine_stamps, EPOCH), values, primary=name == "boom.cylinder")
        for name, values in x.items()
    ]
    found = continued(_stamps(stamps, OTHER))
    carried_on = found.stamps
    rows, _ = in_order(carried_on, "mocap.csv")
    channels += [Channel(name, "mocap.csv", "mocap", carried_on[rows], values[rows]) for name, values in y.items()]
    clocks = RecordingClocks("log", "motion", tuple(channels))
    times = (carried_on[rows] - OTHER) * 1e-9
    truth = truth + (stamps - stream) * (1.0 + skew)  # of the stamps: when the frames were taken, jitter hides
    parts = 2 if kind == "reset" and not found.rows else 1
    return SimulatedRecording(clocks, times, truth[rows], 1e6 * skew, reset_s, reset_by, parts)


def _stamps(seconds: Array, origin: int) -> npt.NDArray[np.int64]:
    return np.asarray(origin + np.rint(seconds * 1e9), dtype=np.int64)


def _set(stream: Array, truth: Array, seconds: float, rng: np.random.Generator) -> tuple[Array, Array, float, float]:
    """The clock is set back, set forward, or continues evenly although frames are missing."""
    row = int(rng.uniform(0.3, 0.7) * len(stream))
    size = float(rng.uniform(0.1, 3.0))
    how = rng.integers(3)
    after = np.arange(len(stream)) >= row
    if how == 0:
        return stream - size * after, truth, float(truth[row]), -size
    if how == 1:
        return stream + size * after, truth, float(truth[row]), size
    missing = truth + size * after
    keep = missing < seconds
    return stream[keep], missing[keep], float(missing[row]), -size


def _gaps(times: Array, values: Array, count: float, rng: np.random.Generator) -> Array:
    """NaN for 0.1 to 3 s, ``count`` times on average."""
    result = values.copy()
    for start in rng.uniform(times[0], times[-1], rng.poisson(count)):
        result[(times > start) & (times < start + rng.uniform(0.1, 3.0))] = np.nan
    return result


def _outliers(times: Array, values: Array, rng: np.random.Generator) -> Array:
    """Outliers in one frame of 200, and twice a minute a confused marker for 0.1 to 1 s."""
    result = values.copy()
    wrong = rng.random(len(values)) < 0.005
    result[wrong] += rng.uniform(-3.0, 3.0, np.count_nonzero(wrong))
    for start in rng.uniform(times[0], times[-1], rng.poisson((times[-1] - times[0]) / 30.0)):
        result[(times > start) & (times < start + rng.uniform(0.1, 1.0))] += rng.choice([-0.8, 0.8])
    return result
