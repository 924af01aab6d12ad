"""Motion of the joints as inputs of the servo axes of an arm, for the run of each by itself (:mod:`.servo_axis`)."""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline

from sysid.datasets.recording import Recording
from sysid.machine import Axis
from sysid.plant import servo_law
from sysid.plant.arm_dynamics import link_series, mass_ratios
from sysid.plant.layout import axis_memory
from sysid.plant.machine_arrays import LEAD
from sysid.plant.servo_arm import LONGEST, run_servos
from sysid.plant.servo_axis import OWN, PLACE, SERIES, SLOPE, SPEED, starts_of
from sysid.plant.smooth_motion import second_difference, smooth_motion
from sysid.plant.stretches import common_stretches
from sysid.signals import axis_signal

if TYPE_CHECKING:
    from sysid.plant.model import Model

Array = npt.NDArray[np.float64]

#: Rows that the links make.
LINKS = slice(OWN, SLOPE + 1)
#: Most samples of the motion of a recording, which bound its memory; fewer steps between its rows follow.
MOST = 500_000
#: Place of the series in a recording's cache.
_SERIES = "servo series"


def _motion(joint: Array, rate_hz: float) -> CubicHermiteSpline:
    """Low-passed positions (n,), missing ones interpolated, over time [s]; zero where none are known."""
    time = np.arange(max(len(joint), 2)) / rate_hz
    place, speed = np.zeros((2, len(time)))
    if np.count_nonzero(~np.isnan(joint)) > 1:
        place, speed, _ = smooth_motion(joint, rate_hz)
        speed = speed - second_difference(speed) / 6.0  # a central difference loses (ω·dt)²/6
    return CubicHermiteSpline(time, place, speed)


class LinkSeries:
    """Series of the axes of a plant in one recording, in SI units.

    The joints move as the free run of the plant does between the samples, and as they were measured over longer times: samples
    do not show the accelerations after a step of a command. The series are linear in the inertial parameters of each body:
    what each adds is computed once, when first needed.
    """

    def __init__(self, model: Model, recording: Recording) -> None:
        self.arrays, self._links, self._lock = model.arrays, dict[int | None, Array](), threading.Lock()
        names, rate = model.machine.axis_names, recording.rate_hz
        lead, most = model.arrays.axes[:, LEAD], max(1, MOST // len(recording))
        own = servo_law.own_steps.py_func(lead[0], 1.0 / rate) if (lead == lead[0]).all() else 0
        fine = min(own or math.ceil(1.0 / (rate * LONGEST) - 1e-9), most) if model.links_move else 1
        places, speeds = _simulated(model, recording, fine)
        joints = np.stack([recording.values(axis_signal(name, "joint")) for name in names], axis=1)
        read = places + lead * speeds
        beside = [_motion(joint, rate) for joint in (joints - read[::fine]).T]
        time = np.arange(len(places)) / (rate * fine)
        places += np.stack([spline(time) for spline in beside], axis=1)
        speeds += np.stack([spline(time, 1) for spline in beside], axis=1)
        self._motion, self._step, self._fine = (places, speeds), 1.0 / (rate * fine), fine
        # Steps of the described simulator take the inertia and the torques at their begin, else they are means.
        self._lead, self._ahead = (lead, 1.0) if fine == own else (0.0 * lead, 0.5)

    @property
    def motion(self) -> tuple[Array, Array]:
        """Places and speeds at the samples of the recording, (n, A) each."""
        places, speeds = self._motion
        return places[:: self._fine], speeds[:: self._fine]

    def of(self, axis: int, theta: Array) -> Array:
        """Series of an axis for the parameters ``theta`` of a plant, (SERIES, n · F)."""
        found = np.empty((SERIES, len(self._motion[0])))
        found[LINKS], found[PLACE], found[SPEED] = self._of_body(None)[axis], *(part[:, axis] for part in self._motion)
        ratios = mass_ratios(self.arrays, theta)
        for j in np.flatnonzero(ratios != 1.0):
            found[LINKS] += (ratios[j] - 1.0) * self._of_body(int(j))[axis]
        return found

    def _of_body(self, j: int | None) -> Array:
        """Rows :data:`LINKS` of all axes by body ``j``, by all bodies of the URDF where it is None, (A, 3, n · F)."""
        with self._lock:
            if j not in self._links:
                alone = np.arange(len(self.arrays.bodies)) == j
                self._links[j] = self._of(self.arrays.bodies * (alone if j is not None else ~alone)[:, None])
            return self._links[j]

    def _of(self, bodies: Array) -> Array:
        places, speeds = self._motion
        own, bias, coupled, slope = np.zeros((4, *places.T.shape))
        if bodies[:, 0].any():
            mean, places = np.diff(speeds, axis=0, append=speeds[-1:]) / self._step, places + self._lead * speeds
            link_series(self.arrays.links, bodies, places, speeds, mean, self._ahead, own, bias, coupled, slope)
        mean = coupled[:, :-1] + self._ahead * bias[:, :-1] + (1.0 - self._ahead) * bias[:, 1:]
        return np.stack([own, np.pad(np.cumsum(mean, axis=1), ((0, 0), (1, 0))), slope], axis=1)


def _simulated(model: Model, recording: Recording, fine: int) -> Array:
    """Places and speeds of the free run of all axes, (2, n · fine, A).

    Where no commands are, it rests.
    """
    machine, dt = model.machine, 1.0 / (recording.rate_hz * fine)
    held = [model.held(recording, name) for name in machine.axis_names]
    stretches, count = common_stretches([part for _, part in held], len(recording)), len(recording) * fine
    commands = np.column_stack([values for values, _ in held])
    starts = np.full((model.axes, len(stretches), axis_memory(dt)), np.nan)
    for i, name in enumerate(machine.axis_names):
        motion = _motion(recording.values(axis_signal(name, "joint")), recording.rate_hz)
        places, speeds = motion(motion.x), motion(motion.x, 1)
        place = places - model.arrays.axes[i, LEAD] * speeds
        starts_of(model.theta, model.arrays, i, place, speeds, stretches, dt, starts[i])
    found = np.full((2, count, model.axes), np.nan)
    for k, (first, last) in enumerate(stretches):
        given, rows = np.repeat(commands[first:last], fine, axis=0), slice(first * fine, last * fine)
        run_servos(model.theta, model.arrays, given, starts[:, k].ravel(), dt, *found[:, rows])
    found[1] = np.nan_to_num(found[1])
    every, there = np.arange(count), np.isfinite(found[0]).all(axis=1)
    for column in found[0].T:
        column[:] = np.interp(every, every[there], column[there]) if there.any() else 0.0
    return found


def servo_series(model: Model, recording: Recording) -> LinkSeries:
    """Series of all axes of a plant, cached in the recording."""
    key = (model.arrays.links.tobytes(), model.arrays.bodies.tobytes(), model.theta.tobytes())
    known: tuple[tuple[bytes, ...], LinkSeries] | None = recording.derived.get(_SERIES)
    if known is None or known[0] != key:
        known = recording.derived[_SERIES] = key, LinkSeries(model, recording)
    return known[1]


def servo_force(axis: Axis, recording: Recording) -> Array:
    """Force of the described controller of a servo axis at its measured motion, (n,) [N·m or N]; NaN where not measured."""
    assert axis.servo is not None
    command, joint = (recording.values(axis_signal(axis.name, part)) for part in ("command", "joint"))
    if np.count_nonzero(~np.isnan(joint)) < 2:
        return np.full(len(joint), np.nan)
    place, speed, _ = smooth_motion(joint, recording.rate_hz)
    return np.clip(axis.servo.kp * (command - place) - axis.servo.kv * speed, *axis.servo.force_range)
