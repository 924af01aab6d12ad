"""Figures of one axis that a mistake in a unit or a sign changes: ranges, response to the command, linkage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import known
from sysid.datasets.plausibility.response import Response
from sysid.datasets.recording import Recording
from sysid.machine import Axis, TriangleLinkage
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]
#: Samples of a recording for quantiles.
MAX_SAMPLES = 2**14
#: Quantiles that bound a signal, robust against single outliers.
ENDS = (0.002, 0.998)


@dataclass(frozen=True)
class Span:
    """Range of a signal [SI], without the outermost 0.2 % of the samples at either end; ``rest``: its commonest value."""

    low: float
    high: float
    rest: float

    @property
    def width(self) -> float:
        return self.high - self.low

    @property
    def peak(self) -> float:
        return max(abs(self.low), abs(self.high))

    def divided(self, factor: float) -> Span:
        low, high = sorted((self.low / factor, self.high / factor))
        return Span(low, high, self.rest / factor)


@dataclass(frozen=True)
class Pairs:
    """Cylinder and joint of the same rows, (n,) each, and the linkage between them."""

    cylinder: Array
    joint: Array
    linkage: TriangleLinkage


@dataclass(frozen=True)
class AxisFigures:
    """Figures of one axis over all recordings; None where they are unknown.

    Args:
        unit: of the joint, ``rad`` or ``m``; None where the description does not say it.
        command, driven, joint: ranges; ``joint`` only where it is not the driven signal.
        ends, joint_ends: stroke and limits.
        response: to the command, see :class:`Response`; ``expected``: its nominal value (gain, 1 or inertia).
        rate_ratio: sample rate of the streams / rate of the grid.
    """

    axis: Axis
    unit: str | None
    command: Span | None
    driven: Span | None
    joint: Span | None
    ends: tuple[float, float] | None
    joint_ends: tuple[float, float] | None
    response: Response | None
    expected: float
    pairs: Pairs | None
    rate_ratio: float | None = None

    @property
    def ratio(self) -> float | None:
        """Measured response / nominal response; negative where the motion opposes the command."""
        return None if self.response is None else self.response.value / self.expected

    def corrected(self, quantity: str, factor: float) -> AxisFigures:
        """The figures if ``quantity`` were smaller by ``factor``."""
        power = _POWERS[self.axis.actuation].get(quantity, 0)
        response = None if self.response is None else self.response.scaled(factor**power)
        changed = replace(self, response=response)
        if quantity == "command":
            return replace(changed, command=_divided(self.command, factor))
        if quantity == "driven":
            changed = replace(changed, driven=_divided(self.driven, factor))
            return replace(changed, pairs=_scaled_pairs(self.pairs, factor, 1.0))
        if quantity == "joint":
            return replace(changed, joint=_divided(self.joint, factor), pairs=_scaled_pairs(self.pairs, 1.0, factor))
        if quantity == "ends":
            return replace(changed, ends=_ends(self.ends, factor))
        if quantity == "joint_ends":
            return replace(changed, joint_ends=_ends(self.joint_ends, factor))
        if quantity == "expected":
            return replace(changed, expected=self.expected / factor)
        if quantity == "time":
            return replace(changed, rate_ratio=None if self.rate_ratio is None else self.rate_ratio * factor)
        raise ValueError(quantity)

    def exchanged(self) -> AxisFigures:
        """The figures if the columns of cylinder and joint were exchanged."""
        response = None
        if self.response is not None and self.driven is not None and self.joint is not None and self.driven.width > 0.0:
            response = self.response.scaled(self.joint.width / self.driven.width)
        pairs = None if self.pairs is None else Pairs(self.pairs.joint, self.pairs.cylinder, self.pairs.linkage)
        return replace(self, driven=self.joint, joint=self.driven, response=response, pairs=pairs)


#: Actuation → quantity → power of the correction in the response.
_POWERS = {
    "velocity": {"command": 1, "driven": -1, "time": 1},
    "position": {"command": 1, "driven": -1},
    "servo": {"command": 1, "driven": -1},
    "force": {"command": -1, "driven": 1, "time": -2},
}


def _divided(span: Span | None, factor: float) -> Span | None:
    return None if span is None else span.divided(factor)


def _ends(ends: tuple[float, float] | None, factor: float) -> tuple[float, float] | None:
    return None if ends is None else (ends[0] / factor, ends[1] / factor)


def _scaled_pairs(pairs: Pairs | None, cylinder: float, joint: float) -> Pairs | None:
    return None if pairs is None else Pairs(pairs.cylinder / cylinder, pairs.joint / joint, pairs.linkage)


def span_of(recordings: Sequence[Recording], signal: str) -> Span | None:
    """Range of a signal over recordings; None where it was not measured."""
    parts = [known(thinned(r.values(signal))) for r in recordings if signal in r.signals]
    values = np.concatenate(parts) if parts else np.empty(0)
    if not len(values):
        return None
    low, high = np.quantile(values, ENDS)
    levels, counts = np.unique(np.round(values, 9), return_counts=True)
    return Span(float(low), float(high), float(levels[np.argmax(counts)]))


def thinned(values: Array, most: int = MAX_SAMPLES) -> Array:
    """At most ``most`` evenly spaced samples."""
    return values[:: max(1, math.ceil(len(values) / most))]


def pairs_of(recordings: Sequence[Recording], axis: Axis) -> Pairs | None:
    """Samples of cylinder and joint, where the description has their linkage."""
    if axis.linkage is None or axis.drives != "cylinder":
        return None
    cylinders, joints = [], []
    for recording in recordings:
        both = [thinned(recording.values(axis_signal(axis.name, quantity)), 500) for quantity in ("cylinder", "joint")]
        there = ~np.isnan(both[0]) & ~np.isnan(both[1])
        cylinders.append(both[0][there])
        joints.append(both[1][there])
    cylinder, joint = np.concatenate(cylinders), np.concatenate(joints)
    return Pairs(cylinder, joint, TriangleLinkage(axis.linkage)) if len(cylinder) > 10 else None
