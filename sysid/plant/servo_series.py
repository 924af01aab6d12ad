"""Motion of the joints as inputs of the servo axes of an arm, for the run of each by itself (:mod:`.servo_axis`)."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Hashable
from functools import cached_property, partial

import numpy as np
import numpy.typing as npt
import scipy

from sysid.datasets.recording import Recording
from sysid.machine import Axis, Machine
from sysid.plant import servo_law
from sysid.plant.arm_dynamics import link_series, mass_ratios
from sysid.plant.layout import axis_memory
from sysid.plant.machine_arrays import LEAD, MachineArrays
from sysid.plant.servo_arm import LONGEST, run_servos, workspace
from sysid.plant.servo_axis import OWN, PLACE, SERIES, SLOPE, SPEED, UNDAMPED, starts_of
from sysid.plant.smooth_motion import POSITION_HZ, second_difference, smooth_motion
from sysid.plant.stretches import Segments, common_stretches, held_for
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Rows that the links make.
LINKS = slice(OWN, SLOPE + 1)
#: Most samples of the motion of a recording, which bound its memory; fewer steps between its rows follow.
MOST = 1_000_000
#: Time from whose motion the begin is estimated [s], and least samples of it.
BEGIN, LEAST_BEGIN = 0.2, 6
#: A begin fits the plant below this error, and a joint rests below this speed [standard deviations].
FITS, RESTS = 2.0, 3.0
#: Cut-off of slow differences [Hz], and mean square that counts as noise [variances].
SLOW_HZ, NOISY = 4.0, 3.0
#: Places of the series, and of the begins of runs, in a recording's cache.
_SERIES, _BEGINS = "servo series", "servo begins"


def _motion(joint: Array, rate_hz: float) -> scipy.interpolate.CubicHermiteSpline:
    """Low-passed positions (n,), missing ones interpolated, over time [s]; zero where none are known."""
    known = np.count_nonzero(~np.isnan(joint)) > 1
    return _spline(smooth_motion(joint, rate_hz)[0] if known else np.zeros(max(len(joint), 2)), rate_hz)


def _spline(place: Array, rate_hz: float) -> scipy.interpolate.CubicHermiteSpline:
    """Smooth positions (n,) over time [s]."""
    speed = np.gradient(place, 1.0 / rate_hz)
    # A central difference loses (ω·dt)²/6.
    return scipy.interpolate.CubicHermiteSpline(np.arange(len(place)) / rate_hz, place, speed - second_difference(speed) / 6.0)


def _difference(joint: Array, run: Array, rate_hz: float) -> scipy.interpolate.CubicHermiteSpline:
    """Measured less simulated positions (n,) over time [s], slow and fast ones where they exceed the noise.

    Noise of the other joints would shake an axis that dry friction holds.
    """
    sigma, count = _noise(joint), np.count_nonzero(~np.isnan(joint))
    if count < 2:
        return _spline(np.zeros(max(len(joint), 2)), rate_hz)
    slow, whole = (smooth_motion(joint - run, rate_hz, cut)[0] for cut in (SLOW_HZ, POSITION_HZ))
    parts = (slow, sigma**2 * min(1.0, 2.0 * SLOW_HZ / rate_hz)), (whole - slow, sigma**2)
    return _spline(sum((_beyond(part, noise, rate_hz) for part, noise in parts), start=np.zeros(len(slow))), rate_hz)


def _beyond(values: Array, noise: float, rate_hz: float) -> Array:
    """Values (n,) less what noise of a variance may be of them, by their mean square within :data:`BEGIN`."""
    local = scipy.ndimage.uniform_filter1d(values**2, max(3, round(BEGIN * rate_hz)), mode="nearest")
    return np.asarray(values * np.clip(1.0 - NOISY * noise / np.maximum(local, 1e-30), 0.0, 1.0))


class LinkSeries:
    """Series of the axes of a plant in one recording, in SI units.

    The joints move as the free run of the plant does between the samples, and as they were measured over longer times: samples
    do not show the accelerations after a step of a command. The series are linear in the inertial parameters of each body:
    what each adds is computed once, when first needed.
    """

    def __init__(self, machine: Machine, arrays: MachineArrays, theta: Array, recording: Recording) -> None:
        self.arrays, self._links, self._lock = arrays, dict[int, Array](), threading.Lock()
        names, rate = machine.axis_names, recording.rate_hz
        lead, (fine, own) = arrays.axes[:, LEAD], _steps(arrays, recording)
        (places, speeds, self._undamped), runs = _simulated(machine, arrays, theta, recording, fine)
        alone = places[::fine].copy(), speeds[::fine].copy()
        joints = np.stack([recording.values(axis_signal(name, "joint")) for name in names], axis=1)
        read = places + lead * speeds
        beside = [_difference(*columns, rate) for columns in zip(joints.T, read[::fine].T, strict=True)]
        time = np.arange(len(places)) / (rate * fine)
        places += np.stack([spline(time) for spline in beside], axis=1)
        speeds += np.stack([spline(time, 1) for spline in beside], axis=1)
        self._motion, self._step = (places, speeds), 1.0 / (rate * fine)
        self._begins = [np.where(runs[:, None], own, part[::fine]) for own, part in zip(alone, self._motion, strict=True)]
        # Steps of the described simulator take the inertia and the torques at their begin, else they are means.
        self._lead, self._ahead = (lead, 1.0) if own else (0.0 * lead, 0.5)

    def begins(self, axis: int) -> tuple[Array, Array]:
        """Places and speeds of an axis at the samples of the recording, (n,) each, from which a stretch of it begins."""
        places, speeds = self._begins
        return np.ascontiguousarray(places[:, axis]), np.ascontiguousarray(speeds[:, axis])

    def of(self, axis: int, theta: Array) -> Array:
        """Series of an axis for the parameters ``theta`` of a plant, (SERIES, n · F), not to be changed."""
        with self._lock:
            described: Array = self._described[axis]
        ratios = mass_ratios(self.arrays, theta)
        changed = np.flatnonzero(ratios != 1.0)
        if not len(changed):
            return described
        found: Array = described.copy()
        for j in changed:
            found[LINKS] += (ratios[j] - 1.0) * self._of_body(int(j))[axis]
        return found

    @cached_property
    def _described(self) -> Array:
        """Series of all axes with the masses of the URDF, (A, SERIES, n · F)."""
        places, speeds = self._motion
        found = np.empty((places.shape[1], SERIES, len(places)))
        found[:, LINKS], found[:, PLACE], found[:, SPEED] = self._of(self.arrays.bodies), places.T, speeds.T
        found[:, UNDAMPED] = self._undamped.T
        return found

    def _of_body(self, j: int) -> Array:
        """Rows :data:`LINKS` of all axes by body ``j``, (A, 3, n · F)."""
        with self._lock:
            if j not in self._links:
                self._links[j] = self._of(self.arrays.bodies * (np.arange(len(self.arrays.bodies)) == j)[:, None])
            return self._links[j]

    def _of(self, bodies: Array) -> Array:
        places, speeds = self._motion
        own, bias, coupled, slope = np.zeros((4, *places.T.shape))
        if bodies[:, 0].any():
            mean, places = np.diff(speeds, axis=0, append=speeds[-1:]) / self._step, places + self._lead * speeds
            link_series(self.arrays.links, bodies, places, speeds, mean, self._ahead, own, bias, coupled, slope)
        mean = coupled[:, :-1] + self._ahead * bias[:, :-1] + (1.0 - self._ahead) * bias[:, 1:]
        return np.stack([own, np.pad(np.cumsum(mean, axis=1), ((0, 0), (1, 0))), slope], axis=1)


def _steps(arrays: MachineArrays, recording: Recording) -> tuple[int, bool]:
    """Steps of the motion between two samples, and whether they are those of the described simulator."""
    rate, lead, most = recording.rate_hz, arrays.axes[:, LEAD], max(1, MOST // len(recording))
    own = servo_law.own_steps.py_func(lead[0], 1.0 / rate) if (lead == lead[0]).all() else 0
    fine = min(own or math.ceil(1.0 / (rate * LONGEST) - 1e-9), most) if arrays.bodies[:, 0].any() else 1
    return fine, fine == own


def servo_begins(machine: Machine, arrays: MachineArrays, theta: Array, recording: Recording) -> tuple[Array, Array]:
    """Places and speeds of all joints in which each stretch with all commands begins, (n, A) each, NaN at other samples.

    They are cached in the recording.
    """
    key = _key(machine, arrays, theta)
    known: tuple[Hashable, tuple[Array, Array]] | None = recording.derived.get(_BEGINS)
    if known is None or known[0] != key:
        commands, stretches = _commands(machine, recording)
        joints = np.stack([recording.values(axis_signal(name, "joint")) for name in machine.axis_names], axis=1)
        places, speeds = np.full((2, *joints.shape), np.nan)
        rate, fine = recording.rate_hz, _steps(arrays, recording)[0]
        for first, last in stretches:
            run = partial(_run, arrays, theta, commands[first:last], 1.0 / rate, fine)
            places[first], speeds[first] = _begin(run, joints[first:last], rate, arrays.axes[:, LEAD])
        known = recording.derived[_BEGINS] = key, (places, speeds)
    return known[1]


def _key(machine: Machine, arrays: MachineArrays, theta: Array) -> Hashable:
    """All that the motion of the joints depends on beside the recording."""
    shifts = tuple(machine.command_shift(name) for name in machine.axis_names)
    return shifts, arrays.axes.tobytes(), arrays.links.tobytes(), arrays.bodies.tobytes(), theta.tobytes()


def _commands(machine: Machine, recording: Recording) -> tuple[Array, Segments]:
    """Commands of all axes (n, A), held over short gaps, and the stretches in which all have one."""
    held = [held_for(machine, recording, name) for name in machine.axis_names]
    return np.column_stack([values for values, _ in held]), common_stretches([part for _, part in held], len(recording))


def _simulated(
    machine: Machine, arrays: MachineArrays, theta: Array, recording: Recording, fine: int
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Places, speeds, undamped torques of the free run of all axes, (3, n · fine, A), and the samples (n,) in which it runs."""
    commands, stretches = _commands(machine, recording)
    begins, count = np.stack(servo_begins(machine, arrays, theta, recording)), len(recording) * fine
    found = np.full((3, count, commands.shape[1]), np.nan)
    for first, last in stretches:
        part = commands[first:last]
        found[:, first * fine : last * fine] = _run(
            arrays, theta, part, 1.0 / recording.rate_hz, fine, begins[:, first], last - first
        )
    found[1:] = np.nan_to_num(found[1:])
    every, there = np.arange(count), np.isfinite(found[0]).all(axis=1)
    for column in found[0].T:
        column[:] = np.interp(every, every[there], column[there]) if there.any() else 0.0
    return found, there[::fine]


def _run(arrays: MachineArrays, theta: Array, commands: Array, dt: float, fine: int, begin: Array, count: int) -> Array:
    """Places, speeds and undamped torques (3, count · fine, A) from places and speeds of the begin (2, A)."""
    axes = len(arrays.axes)
    whole, states = np.array([[0, count]]), np.full((axes, 1, axis_memory(dt / fine)), np.nan)
    for i in range(axes):
        starts_of(theta, arrays, i, begin[0, i : i + 1], begin[1, i : i + 1], whole, dt / fine, states[i])
    found = np.empty((3, count * fine, axes))
    run_servos(theta, arrays, np.repeat(commands[:count], fine, axis=0), states.ravel(), dt / fine, *found, workspace(arrays))
    return found


def _begin(run: Callable[[Array, int], Array], joints: Array, rate_hz: float, lead: Array) -> Array:
    """Place and speed (2, A) in which measured joints (n, A) begin.

    They are those from which the plant moves as measured for a short time; where it does not, those of the low-passed
    measurement, at rest where its speed is less than its noise.
    """
    begin = np.array([_from_motion(joint, rate_hz) for joint in joints.T]).T
    begin[0] -= lead * begin[1]
    count = min(len(joints), max(LEAST_BEGIN, round(BEGIN * rate_hz)))
    measured, fine = joints[:count], run(begin, count).shape[1] // count
    if np.isnan(measured).any() or count < LEAST_BEGIN:
        return begin

    def errors(start: Array) -> Array:
        place, speed, _ = run(start, count)
        return np.ravel(measured - (place + lead * speed)[::fine])

    noise = np.maximum([_noise(joint) for joint in joints.T], 1e-9)
    weight = np.broadcast_to(1.0 / noise, measured.shape).ravel()
    best, step = begin, np.array([noise, noise * rate_hz])
    left = errors(best) * weight
    for _ in range(2):
        columns = []
        for k in np.ndindex(step.shape):
            moved = best.copy()
            moved[k] += step[k]
            columns.append(left - errors(moved) * weight)
        better = best + step * np.linalg.lstsq(np.array(columns).T, left, rcond=1e-6)[0].reshape(step.shape)
        rest = errors(better) * weight
        if not rest @ rest < left @ left:
            break
        best, left = better, rest
    fits: npt.NDArray[np.bool_] = (left.reshape(measured.shape) ** 2).mean(axis=0) < FITS**2
    return np.asarray(np.where(fits, best, begin))


def _from_motion(joint: Array, rate_hz: float) -> tuple[float, float]:
    """Place and speed at the first sample of a low-passed position (n,)."""
    motion = _motion(joint, rate_hz)
    first = joint[: max(LEAST_BEGIN, round(0.5 * BEGIN * rate_hz))]
    first = first[~np.isnan(first)]
    if len(first) >= LEAST_BEGIN:
        time = (np.arange(len(first)) - 0.5 * (len(first) - 1)) / rate_hz
        slope = float(time @ first) / float(time @ time)
        if abs(slope) < RESTS * _noise(joint) / float(np.sqrt(time @ time)):
            return float(first.mean()), 0.0
    return float(motion(0.0)), float(motion(0.0, 1))


def _noise(joint: Array) -> float:
    """Standard deviation of white noise, from third differences."""
    third = np.abs(np.diff(joint[~np.isnan(joint)], 3))
    return float(np.median(third)) * 1.4826 / 20.0**0.5 if len(third) else 0.0


def servo_series(machine: Machine, arrays: MachineArrays, theta: Array, recording: Recording) -> LinkSeries:
    """Series of all axes of a plant with the parameters ``theta``, cached in the recording."""
    key = _key(machine, arrays, theta)
    known: tuple[Hashable, LinkSeries] | None = recording.derived.get(_SERIES)
    if known is None or known[0] != key:
        known = recording.derived[_SERIES] = key, LinkSeries(machine, arrays, theta, recording)
    return known[1]


def servo_force(axis: Axis, recording: Recording) -> Array:
    """Force of the described controller of a servo axis at its measured motion, (n,) [N·m or N]; NaN where not measured."""
    assert axis.servo is not None
    command, joint = (recording.values(axis_signal(axis.name, part)) for part in ("command", "joint"))
    if np.count_nonzero(~np.isnan(joint)) < 2:
        return np.full(len(joint), np.nan)
    place, speed, _ = smooth_motion(joint, recording.rate_hz)
    return np.clip(axis.servo.kp * (command - place) - axis.servo.kv * speed, *axis.servo.force_range)
