"""Force axes evaluated by the force at measured motion: inverse dynamics under one stated filter on both sides.

The position is low-passed forward and backward (Butterworth) and differentiated centrally; the same zero-phase low-pass
runs over the measured and the model force, which are then decimated so that the samples are nearly independent
(Gautier, Janot, Vandanjon, IEEE TCST 21 (2013): the "parallel decimation" of robot identification).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import scipy

from sysid.datasets.recording import Recording
from sysid.errors import ExcitationError
from sysid.machine import Axis
from sysid.plant.link_torque import link_torque
from sysid.plant.smooth_motion import HIGHEST, POSITION_HZ, smooth_motion
from sysid.signals import axis_signal

if TYPE_CHECKING:
    from sysid.plant.model import Model

Array = npt.NDArray[np.float64]


#: Least number of samples with position and force.
LEAST_SAMPLES = 100
#: Least bandwidth of the comparison [Hz]: a lower one loses friction near a reversal, and saves nothing but time.
LEAST_HZ = 10.0
#: Cut-off of the position over that of the force, so that the position's filter changes less than 0.1 % inside the band.
POSITION_RATIO = 2.5
#: Standard deviations of its noise within which a speed has no certain sign.
NOISE_WIDTHS = 2.0
#: Rows that survive for each unknown of rigid motion with friction by direction (inertia, two viscous, two dry, a constant).
ROWS_PER_UNKNOWN, UNKNOWNS = 3, 6


@dataclass(frozen=True)
class ForceFilter:
    """The stated filter; :func:`sysid.plant.force_band.force_filter` chooses it from recordings.

    Args:
        position_hz, force_hz: cut-off of the position, and of the force on both sides [Hz].
        still: speed [share of the 95th percentile] below which friction is not determined. Nor is it within the noise of the
            speed, or within half a period of the position's low-pass around a reversal, where the sign of the filtered speed
            may differ from that of the true speed.
        delay: of the force against the motion [samples], see :func:`sysid.plant.force_delay.force_delay`.
    """

    position_hz: float = POSITION_HZ
    force_hz: float = LEAST_HZ
    order: int = 4
    still: float = 0.01
    delay: float = 0.0


def highest_force_hz(rate_hz: float) -> float:
    """Largest bandwidth at a sample rate [Hz]: the position's cut-off is above it."""
    return HIGHEST * rate_hz / POSITION_RATIO


@dataclass(frozen=True)
class Motion:
    """Position and force of an axis on every sample of a recording (n,), gaps interpolated; ``there``: measured samples."""

    position: Array
    force: Array
    there: npt.NDArray[np.int64]
    rate_hz: float


def measured_motion(recording: Recording, axis: Axis) -> Motion | None:
    """Position and force of an axis; None where fewer than 100 samples contain both."""
    position, force = recording.values(axis.driven), recording.values(axis_signal(axis.name, "command"))
    there = np.flatnonzero(~np.isnan(position) & ~np.isnan(force))
    if len(there) < LEAST_SAMPLES:
        return None
    every = np.arange(len(position))
    position, force = (np.interp(every, there, values[there]) for values in (position, force))
    return Motion(position, force, there, recording.rate_hz)


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

    @property
    def rate_hz(self) -> float:
        return self.recording.rate_hz

    def compared(self, columns: Array) -> Array:
        """Columns (n, k) as they enter the comparison of the force, (m, k): zero where the axis ``rests``, low-passed."""
        moving = np.where(self.rests[:, None], 0.0, columns)
        return np.asarray(scipy.signal.sosfiltfilt(self.low_pass, moving, axis=0)[self.rows])

    def model_force(self, model: Model, thetas: Array, axis: str, everywhere: bool = False) -> Array:
        """Force that the model needs for the measured motion, (lanes, m); ``everywhere`` also where the axis ``rests``."""
        out = np.empty((len(thetas), len(self.rows)))
        for lane, theta in enumerate(thetas):
            links = link_torque(model, theta, self.recording, axis)
            motion = self.position, self.speed, self.acceleration
            full = model.inverse(theta, axis, *motion, 1.0 / self.rate_hz, links.carried) + links.commanded
            if not everywhere:
                full[self.rests] = self.raw[self.rests]
            out[lane] = scipy.signal.sosfiltfilt(self.low_pass, full)[self.rows]
        return out


def force_inputs(
    recording: Recording, axis: Axis, settings: ForceFilter | None = None, rows: npt.NDArray[np.int64] | None = None
) -> ForceInputs:
    """Filter one recording for the force comparison.

    Args:
        rows: fixes which samples survive.

    Raises:
        ExcitationError: the axis is not measured throughout, hardly moves, or moves for too short a time.
    """
    settings = settings or ForceFilter()
    where = f"{recording.name}: {axis.name}"
    motion = measured_motion(recording, axis)
    if motion is None:
        raise ExcitationError(where, "force and motion are not measured together", f"{LEAST_SAMPLES} samples")
    rate = motion.rate_hz
    low_pass = scipy.signal.butter(settings.order, min(settings.force_hz, HIGHEST * rate), fs=rate, output="sos")
    force = delayed(motion.force, settings.delay)
    position, speed, acceleration = smooth_motion(motion.position, rate, settings.position_hz, settings.order)
    filtered = scipy.signal.sosfiltfilt(low_pass, force)
    still = settings.still * float(np.percentile(np.abs(speed), 95))
    uncertain = max(still, NOISE_WIDTHS * _speed_noise(motion, position, settings))
    rests = np.abs(speed) < uncertain + np.abs(acceleration) * 0.5 / settings.position_hz
    if rows is None:
        rows = _rows(motion, speed, still, settings, where)
    return ForceInputs(rows, speed, acceleration, rests, force, filtered[rows], low_pass, position, recording)


def delayed(force: Array, samples: float) -> Array:
    """The force ``samples`` later, averaged over neighbouring samples as in a second difference, (n,).

    A second difference contains (1, 10, 1)/12 of the accelerations of three samples, to fourth order (Numerov).
    """
    shifted = scipy.ndimage.shift(force, samples, order=3, mode="nearest") if samples else force
    before, after = np.concatenate([shifted[:1], shifted[:-1]]), np.concatenate([shifted[1:], shifted[-1:]])
    return np.asarray((before + 10.0 * shifted + after) / 12.0)


def _speed_noise(motion: Motion, position: Array, settings: ForceFilter) -> float:
    """Standard deviation of the noise of the filtered speed: that of the position above its cut-off is white."""
    rate = motion.rate_hz
    share = min(2.0 * settings.position_hz / rate, 2.0 * HIGHEST)
    removed = (motion.position - position)[motion.there]
    # White noise below the cut-off, differentiated: ∫(2πf)²df.
    variance = float(np.var(removed)) * share / max(1.0 - share, 0.2)
    return float(np.sqrt(variance / 3.0)) * np.pi * share * rate


def _rows(motion: Motion, speed: Array, still: float, settings: ForceFilter, where: str) -> npt.NDArray[np.int64]:
    """Samples that are nearly independent, measured, away from the ends, and not at a standstill.

    At rest friction may take any value below break-away.

    Raises:
        ExcitationError: too few of them.
    """
    rate, needed = motion.rate_hz, ROWS_PER_UNKNOWN * UNKNOWNS
    stride = max(1, int(rate / (2.5 * settings.force_hz)))
    edge = 5 * stride
    rows = np.arange(edge, len(speed) - edge, stride)
    rows = rows[np.isin(rows, motion.there)]
    if len(rows) < needed:
        found = f"{len(rows)} independent samples of the force at {settings.force_hz:.0f} Hz"
        raise ExcitationError(where, found, f"{needed}; record it for a longer time, or faster motion")
    spread = int(rate / settings.force_hz)
    slow = np.convolve((np.abs(speed) < still).astype(float), np.ones(2 * spread + 1), mode="same") > spread
    rows = rows[~slow[rows]]
    if len(rows) < needed:
        raise ExcitationError(where, "the axis hardly moves", "motion in both directions")
    return rows
