"""Force axes evaluated by the force at measured motion: inverse dynamics under one stated filter on both sides.

The position is low-passed forward and backward (Butterworth) and differentiated centrally; the same zero-phase low-pass
runs over the measured and the model force, which are then decimated so that the samples are nearly independent
(Gautier, Janot, Vandanjon, IEEE TCST 21 (2013): the "parallel decimation" of robot identification).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy import signal

from sysid.datasets.recording import Recording
from sysid.errors import ExcitationError
from sysid.machine import Axis
from sysid.plant.link_torque import link_torque
from sysid.plant.smooth_motion import POSITION_HZ, smooth_motion
from sysid.signals import axis_signal

if TYPE_CHECKING:
    from sysid.plant.model import Model

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ForceFilter:
    """The stated filter. ``still`` is the speed [share of the 95th percentile] below which friction is not determined.

    Nor is it within half a period of the position's low-pass around a reversal, where the sign of the filtered speed may
    differ from that of the true speed.
    """

    position_hz: float = POSITION_HZ
    force_hz: float = 10.0
    order: int = 4
    still: float = 0.01


@dataclass(frozen=True)
class ForceInputs:
    """Measured motion and force of one axis, filtered and decimated.

    Args:
        rows: rows of the recording that survive, (m,).
        speed, acceleration: on all rows (n,).
        position: low-passed, on all rows (n,).
        rests: samples at which the sign of dry friction is unknown and the measured force is used instead (n,).
        raw: measured force on all rows, not filtered (n,).
        force: measured force on ``rows`` (m,).
        recording: that contains them.
    """

    rows: npt.NDArray[np.int64]
    speed: Array
    acceleration: Array
    rests: npt.NDArray[np.bool_]
    raw: Array
    force: Array
    low_pass: Array
    position: Array
    recording: Recording

    def model_force(self, model: Model, thetas: Array, axis: str, everywhere: bool = False) -> Array:
        """Force that the model needs for the measured motion, (lanes, m); ``everywhere`` also where the axis ``rests``."""
        out = np.empty((len(thetas), len(self.rows)))
        for lane, theta in enumerate(thetas):
            full = model.inverse(theta, axis, self.position, self.speed, self.acceleration, 1.0 / self.recording.rate_hz)
            full += link_torque(model, theta, self.recording, axis)
            if not everywhere:
                full[self.rests] = self.raw[self.rests]
            out[lane] = signal.sosfiltfilt(self.low_pass, full)[self.rows]
        return out


def force_inputs(
    recording: Recording,
    axis: Axis,
    settings: ForceFilter | None = None,
    rows: npt.NDArray[np.int64] | None = None,
    hold: float = 0.0,
) -> ForceInputs:
    """Filter one recording for the force comparison.

    Args:
        rows: fixes which samples survive.
        hold: delay of the force against the motion [samples], see :func:`hold_of`.

    Raises:
        ExcitationError: the axis is not measured throughout or hardly moves.
    """
    settings = settings or ForceFilter()
    rate = recording.rate_hz
    position = recording.values(axis.driven)
    force = recording.values(axis_signal(axis.name, "command"))
    there = np.flatnonzero(~np.isnan(position) & ~np.isnan(force))
    if len(there) < 100:
        raise ExcitationError(f"{recording.name}: {axis.name}", "force and motion are not measured together", "100 samples")
    force = np.interp(np.arange(len(force)), there, force[there])
    low_pass = signal.butter(settings.order, min(settings.force_hz, 0.4 * rate), fs=rate, output="sos")
    force = (1.0 - hold) * force + hold * np.concatenate([force[:1], force[:-1]])
    position, speed, acceleration = smooth_motion(position, rate, settings.position_hz, settings.order)
    filtered = signal.sosfiltfilt(low_pass, force)
    still = settings.still * float(np.percentile(np.abs(speed), 95))
    rests = np.abs(speed) < still + np.abs(acceleration) * 0.5 / settings.position_hz
    if rows is not None:
        return ForceInputs(rows, speed, acceleration, rests, force, filtered[rows], low_pass, position, recording)
    stride = max(1, int(rate / (2.5 * settings.force_hz)))
    edge = 5 * stride
    rows = np.arange(edge, len(position) - edge, stride)
    # At rest friction may take any value below break-away.
    spread = int(rate / settings.force_hz)
    slow = np.convolve((np.abs(speed) < still).astype(float), np.ones(2 * spread + 1), mode="same") > spread
    measured = np.isin(rows, there)
    rows = rows[~slow[rows] & measured]
    if len(rows) < 30:
        raise ExcitationError(f"{recording.name}: {axis.name}", "the axis hardly moves", "motion in both directions")
    return ForceInputs(rows, speed, acceleration, rests, force, filtered[rows], low_pass, position, recording)


def hold_of(recordings: Sequence[Recording], axis: Axis) -> float:
    """Half a sample where the force was held over each step, none where it was sampled with the motion.

    A log does not say which, and half a sample looks like viscous friction. The value with the smaller residual of a fit by
    acceleration, speed in each direction, its sign and a constant is returned (no effect is named from this fit).
    """
    left = []
    for hold in (0.0, 0.5):
        total = 0.0
        for recording in recordings:
            inputs = force_inputs(recording, axis, hold=hold)
            v = inputs.speed
            terms = np.column_stack([inputs.acceleration, np.maximum(v, 0.0), np.minimum(v, 0.0), np.sign(v), np.ones_like(v)])
            terms = signal.sosfiltfilt(inputs.low_pass, terms, axis=0)[inputs.rows]
            total += float(np.sum((inputs.force - terms @ np.linalg.lstsq(terms, inputs.force, rcond=None)[0]) ** 2))
        left.append(total)
    return 0.0 if left[0] <= left[1] else 0.5
