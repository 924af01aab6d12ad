"""What the checks of a dataset look at: its recordings, and figures of each axis that a mistake in a unit or a sign changes
(ranges, response to the command, linkage).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sysid.datasets.chunked import Array, known, strided
from sysid.datasets.quality.responses import Response, motion_of, response_of
from sysid.datasets.recording import Dataset, Recording
from sysid.machine import Axis, Machine, TriangleLinkage
from sysid.machine.rigid_body import moves_masses
from sysid.names import uncut_name
from sysid.signals import axis_signal

#: Samples of a recording for quantiles, and pairs of cylinder and joint.
MAX_SAMPLES, MAX_PAIRS = 2**14, 500
#: Quantiles that bound a signal, robust against single outliers.
ENDS = (0.002, 0.998)


@dataclass(frozen=True)
class SignalRange:
    """Range of a signal [SI], without the outermost 0.2 % of the samples at either end; ``rest``: its commonest value."""

    low: float
    high: float
    rest: float

    @classmethod
    def of(cls, recordings: Sequence[Recording], signal: str) -> SignalRange | None:
        """Of a signal over recordings; None where it was not measured."""
        parts = [known(thinned(r.values(signal))) for r in recordings if signal in r.signals]
        values = np.concatenate(parts) if parts else np.empty(0)
        if not len(values):
            return None
        low, high = np.quantile(values, ENDS)
        levels, counts = np.unique(np.round(values, 9), return_counts=True)
        return cls(float(low), float(high), float(levels[np.argmax(counts)]))

    @property
    def width(self) -> float:
        return self.high - self.low

    @property
    def peak(self) -> float:
        return max(abs(self.low), abs(self.high))

    def divided(self, factor: float) -> SignalRange:
        low, high = sorted((self.low / factor, self.high / factor))
        return SignalRange(low, high, self.rest / factor)


def thinned(values: Array, most: int = MAX_SAMPLES) -> Array:
    """At most ``most`` evenly spaced samples."""
    return strided(values, max(1, math.ceil(len(values) / most)))


@dataclass(frozen=True)
class Pairs:
    """Cylinder and joint of the same rows, (n,) each, and the linkage between them."""

    cylinder: Array
    joint: Array
    linkage: TriangleLinkage

    @classmethod
    def of(cls, recordings: Sequence[Recording], axis: Axis) -> Pairs | None:
        """None where the description of the axis has no linkage."""
        if axis.linkage is None or axis.drives != "cylinder":
            return None
        parts = []
        for recording in recordings:
            both = [thinned(recording.values(axis_signal(axis.name, part)), MAX_PAIRS) for part in ("cylinder", "joint")]
            there = ~np.isnan(both[0]) & ~np.isnan(both[1])
            parts.append([values[there] for values in both])
        cylinder, joint = (np.concatenate(values) for values in zip(*parts, strict=True))
        return cls(cylinder, joint, TriangleLinkage(axis.linkage)) if len(cylinder) > 10 else None


#: Actuation → quantity → power of the correction in the response.
_POWERS = {
    "velocity": {"command": 1, "driven": -1, "time": 1},
    "position": {"command": 1, "driven": -1},
    "servo": {"command": 1, "driven": -1},
    "force": {"command": -1, "driven": 1, "time": -2},
}


@dataclass(frozen=True)
class AxisFigures:
    """Figures of one axis over some recordings; None where they are unknown.

    Args:
        unit: of the joint, ``rad`` or ``m``; None where the description does not say it.
        command, driven, joint: ranges; ``joint`` only where it is not the driven signal.
        ends, joint_ends: stroke and limits.
        response: to the command, see :class:`Response`; ``expected``: its nominal value (gain, 1 or inertia).
        rate_ratio: sample rate of the streams / rate of the grid.
    """

    axis: Axis
    unit: str | None
    command: SignalRange | None
    driven: SignalRange | None
    joint: SignalRange | None
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

    @property
    def driven_unit(self) -> str | None:
        """Unit of what the command drives."""
        return "m" if self.axis.drives == "cylinder" else self.unit

    @property
    def shares(self) -> tuple[float, float] | None:
        """Shares of stroke and limits that cylinder and joint use; None where one of them is unknown."""
        if self.driven is None or self.joint is None or self.ends is None or self.joint_ends is None:
            return None
        return self.driven.width / (self.ends[1] - self.ends[0]), self.joint.width / (self.joint_ends[1] - self.joint_ends[0])

    def signal(self, quantity: str) -> str:
        """The signal of a quantity: ``driven`` → ``boom.cylinder``."""
        return self.axis.driven if quantity == "driven" else axis_signal(self.axis.name, quantity)

    def corrected(self, quantity: str, factor: float) -> AxisFigures:
        """The figures if ``quantity`` (a field, or ``time``) were smaller by ``factor``."""
        power = _POWERS[self.axis.actuation].get(quantity, 0)
        changed: dict[str, Any] = {"response": self.response and self.response.scaled(factor**power)}
        if quantity == "time":
            changed["rate_ratio"] = None if self.rate_ratio is None else self.rate_ratio * factor
        elif quantity == "expected":
            changed["expected"] = self.expected / factor
        elif quantity in ("ends", "joint_ends"):
            ends: tuple[float, float] | None = getattr(self, quantity)
            changed[quantity] = ends and (ends[0] / factor, ends[1] / factor)
        else:
            span: SignalRange | None = getattr(self, quantity)
            changed[quantity] = span and span.divided(factor)
            column = {"driven": "cylinder", "joint": "joint"}.get(quantity)
            if self.pairs is not None and column is not None:
                changed["pairs"] = replace(self.pairs, **{column: getattr(self.pairs, column) / factor})
        return replace(self, **changed)

    def exchanged(self) -> AxisFigures:
        """The figures if the columns of cylinder and joint were exchanged."""
        response = None
        if self.response is not None and self.driven is not None and self.joint is not None and self.driven.width > 0.0:
            response = self.response.scaled(self.joint.width / self.driven.width)
        pairs = self.pairs and replace(self.pairs, cylinder=self.pairs.joint, joint=self.pairs.cylinder)
        return replace(self, driven=self.joint, joint=self.driven, response=response, pairs=pairs)


@dataclass
class CheckContext:
    """A dataset while it is checked: what every check looks at, and what earlier checks leave to later ones.

    Args:
        time_scale: stamps / true time, where their unit is known to be wrong.
        rate_ratio: sample rate of the streams / rate of the grid, where the stamps are plausible.
        usual_gains: axis whose ``gain`` nobody states → that of most of its recordings.
        exchanged: axes with exchanged columns.
        unclear: axes and points with a finding after which other figures of theirs say nothing.
        doubtful: axes whose range, response or description is implausible: whether they move in a role says nothing.
        corrections: axis → factor by which its joint is too large, where that is the likeliest cause.
    """

    dataset: Dataset
    time_scale: float = 1.0
    rate_ratio: float | None = None
    usual_gains: dict[str, float] = field(default_factory=dict)
    exchanged: set[str] = field(default_factory=set)
    unclear: set[str] = field(default_factory=set)
    doubtful: set[str] = field(default_factory=set)
    corrections: dict[str, float] = field(default_factory=dict)

    @property
    def recordings(self) -> Sequence[Recording]:
        return self.dataset.recordings

    @property
    def machine(self) -> Machine:
        return self.dataset.machine

    @property
    def streams(self) -> Mapping[str, Mapping[str, Mapping[str, Any]]]:
        """Recording → stream → figures of its raw samples: rate, counts."""
        found: Mapping[str, Mapping[str, Mapping[str, Any]]] = self.dataset.quality.get("streams", {})
        return found

    @functools.cached_property
    def motion(self) -> tuple[Recording, ...]:
        return self.dataset.of_kind("motion")

    @functools.cached_property
    def by_recording(self) -> dict[str, list[Recording]]:
        """Recording of motion before it was cut → its blocks."""
        parts: dict[str, list[Recording]] = {}
        for recording in self.motion:
            parts.setdefault(uncut_name(recording.name), []).append(recording)
        return parts

    @functools.cached_property
    def figures(self) -> dict[str, AxisFigures]:
        """Recorded axis → its figures over all recordings."""
        recorded = {signal.partition(".")[0] for recording in self.recordings for signal in recording.signals}
        return {axis.name: self.figures_of(self.recordings, axis) for axis in self.machine.axes if axis.name in recorded}

    @property
    def clear(self) -> list[AxisFigures]:
        """Figures of the axes that are not :attr:`unclear`."""
        return [figures for name, figures in self.figures.items() if name not in self.unclear]

    def figures_of(self, recordings: Sequence[Recording], axis: Axis) -> AxisFigures:
        """Figures of an axis over some of the recordings."""
        motion = [recording for recording in recordings if recording.kind == "motion"]
        joint, own = axis_signal(axis.name, "joint"), axis.drives == "joint"
        # Gravity and the other axes of an arm move an axis too: its force alone does not give its acceleration.
        pushed = axis.actuation == "force" and moves_masses(self.machine)
        return AxisFigures(
            axis=axis,
            unit=self.machine.expected_unit(joint) or {"rad": "rad", "m": "m"}.get(self.dataset.units.get(joint, "")),
            command=SignalRange.of(motion, axis_signal(axis.name, "command")),
            driven=SignalRange.of(recordings, axis.driven),
            joint=None if own else SignalRange.of(recordings, joint),
            ends=axis.limits if own else axis.stroke,
            joint_ends=None if own else axis.limits,
            response=None if pushed else response_of(motion_of(motion, axis, axis.driven, self.time_scale), axis),
            expected={"velocity": axis.gain, "position": 1.0, "servo": 1.0, "force": axis.inertia or 1.0}[axis.actuation],
            pairs=Pairs.of(recordings, axis),
            rate_ratio=self.rate_ratio,
        )
