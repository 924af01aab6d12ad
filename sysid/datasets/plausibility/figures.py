"""Figures of one axis that a mistake in a unit or a sign changes (ranges, response to the command, linkage), and what is
expected of them: for each a usual range, and limits beyond which it is named.

The usual ranges come from the machines in ``datasets/``, the measured data in docs/measured-data.md and the simulated test
bench with hidden effects: over all of these the response of valve axes is 0.65 to 1.1 of ``gain``, that of servos 0.53 to 1.0
of the command, and no signal leaves its stroke or limits by more than 1 % of their width. The limits are far wider: a gain
that is off by a factor of two is an effect to be identified, not a mistake in a unit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
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


#: Largest share of one measure in a cost [standard deviations]: one impossible figure does not outweigh all others.
MAX_EXCESS = 10.0
#: Cost at the ends of the usual range [nats]: it orders explanations that are otherwise equal.
PREFERENCE = 0.1
#: Least correlation for which a response is known, by actuation.
LEAST_STRENGTH = {"velocity": 0.5, "position": 0.7, "servo": 0.7, "force": 0.6}
#: Peak of the commands below which a dead-band may take most of them.
SMALL_PEAK = 0.5


@dataclass(frozen=True)
class Measure:
    """One figure, its usual range, and the limits beyond which it is named.

    Args:
        kind: ``range``, ``response``, ``sign``, ``linkage``, ``description`` or ``use``.
        quantity: the signal's quantity, or the key of machine.toml.
        value: logarithm of a ratio, or a share.
        usual: range of honest data; ``sigma``: scale of distances from it.
        notice, severe: (low, high) beyond which the figure is named.
    """

    kind: str
    quantity: str
    value: float
    usual: tuple[float, float]
    sigma: float
    notice: tuple[float, float] = (-math.inf, math.inf)
    severe: tuple[float, float] = (-math.inf, math.inf)

    @property
    def excess(self) -> float:
        """Distance from the usual range [standard deviations], at most :data:`MAX_EXCESS`."""
        beyond = max(self.usual[0] - self.value, self.value - self.usual[1], 0.0)
        return min(beyond / self.sigma, MAX_EXCESS)

    @property
    def cost(self) -> float:
        """Minus log-likelihood, but for a constant; within the usual range its middle is preferred slightly."""
        low, high = self.usual
        from_middle = abs(2.0 * self.value - low - high) / (high - low) if math.isfinite(high - low) and high > low else 0.0
        return 0.5 * self.excess**2 + PREFERENCE * min(from_middle, 1.0)

    @property
    def level(self) -> int:
        """0: plausible; 1: notice; 2: severe."""
        return sum(not low <= self.value <= high for low, high in (self.notice, self.severe))


def _log(low: float, high: float) -> tuple[float, float]:
    return math.log(low), math.log(high)


def measures_of(figures: AxisFigures) -> Iterator[Measure]:
    """All measures that are known for an axis."""
    axis = figures.axis
    if figures.command is not None and figures.command.peak > 0.0:
        if axis.actuation == "velocity":
            yield _full_scale(figures.command)
        elif axis.follows_positions and figures.ends is not None:
            yield from _reach(figures, "command", figures.command, figures.ends, notice=0.5, severe=1.5)
    yield from _response(figures)
    if figures.driven is not None and figures.ends is not None:
        yield from _reach(figures, "driven", figures.driven, figures.ends)
    if figures.joint is not None and figures.joint_ends is not None:
        yield from _reach(figures, "joint", figures.joint, figures.joint_ends)
    yield from _linkage(figures)
    yield from _description(figures)
    if figures.rate_ratio is not None:
        yield Measure("rate", "time", math.log(figures.rate_ratio), _log(0.03, 20.0), 0.7)


def cost_of(figures: AxisFigures) -> float:
    """Minus log-likelihood of the figures, but for a constant: next to zero where all are usual."""
    return sum(measure.cost for measure in measures_of(figures))


def _full_scale(command: Span) -> Measure:
    value = math.log(command.peak)
    usual = _log(0.1, 1.05)
    return Measure("range", "command", value, usual, 0.1 if value > usual[1] else 0.8, (-math.inf, usual[1]), _log(1e-9, 2.0))


def _response(figures: AxisFigures) -> Iterator[Measure]:
    ratio, actuation = figures.ratio, figures.axis.actuation
    if ratio is None or figures.response is None or figures.response.strength < LEAST_STRENGTH[actuation] or ratio == 0.0:
        return
    if ratio < 0.0:
        yield Measure("sign", "response", 1.0, (0.0, 0.0), 0.1, (0.0, 0.0), (0.0, 0.0))
    value = math.log(abs(ratio))
    if actuation == "force":
        yield Measure("response", "response", value, _log(0.3, 3.0), 0.5, _log(1 / 5, 5.0), _log(1 / 10, 10.0))
    elif figures.axis.follows_positions:
        yield Measure("response", "response", value, _log(0.5, 1.1), 0.35, _log(1 / 5, 2.0), _log(1 / 8, 4.0))
    else:
        small = figures.command is not None and figures.command.peak < SMALL_PEAK
        notice, severe = (1 / 10, 1 / 20) if small else (1 / 3, 1 / 5)
        yield Measure("response", "response", value, _log(0.4, 1.5), 0.35, _log(notice, 3.0), _log(severe, 5.0))


def _reach(
    figures: AxisFigures,
    quantity: str,
    span: Span,
    ends: tuple[float, float],
    notice: float = 0.1,
    severe: float = 0.75,
) -> Iterator[Measure]:
    """Positions against stroke or limits, and the share of them that is used."""
    width = ends[1] - ends[0]
    if not (math.isfinite(width) and width > 0.0):
        return
    beyond = max(ends[0] - span.low, span.high - ends[1]) / width
    yield Measure("range", quantity, beyond, (-math.inf, 0.05), 0.1, (-math.inf, notice), (-math.inf, severe))
    if span.width > 0.0:
        moves = figures.response is not None and figures.response.strength > LEAST_STRENGTH[figures.axis.actuation]
        least = _log(0.003, math.inf) if moves and quantity != "command" else (-math.inf, math.inf)
        yield Measure("use", quantity, math.log(span.width / width), _log(0.05, 1.05), 1.0, least)


def _linkage(figures: AxisFigures) -> Iterator[Measure]:
    if figures.pairs is not None:
        pairs = figures.pairs
        spread = float(np.ptp(pairs.joint))
        if spread > 0.0:
            error = pairs.joint - pairs.linkage.joint(pairs.cylinder)
            share = float(np.sqrt(np.mean(error**2))) / spread
            yield Measure("linkage", "joint", share, (0.0, 0.05), 0.05, (-1.0, 0.25), (-1.0, 0.75))
        return
    # Without a linkage: cylinder and joint use about the same share of their ranges, because the map is monotonic.
    if None in (figures.driven, figures.joint, figures.ends, figures.joint_ends):
        return
    assert figures.driven is not None
    assert figures.joint is not None
    assert figures.ends is not None
    assert figures.joint_ends is not None
    used = figures.driven.width / (figures.ends[1] - figures.ends[0])
    used_joint = figures.joint.width / (figures.joint_ends[1] - figures.joint_ends[0])
    if used > 0.0 and used_joint > 0.0:
        yield Measure(
            "linkage", "joint", math.log(used_joint / used), _log(0.5, 2.0), 0.4, _log(1 / 6, 6.0), _log(1 / 20, 20.0)
        )


def _description(figures: AxisFigures) -> Iterator[Measure]:
    """Sizes in machine.toml that no machine has."""
    axis = figures.axis
    linear = axis.drives == "cylinder" or figures.unit == "m"
    rotary = axis.drives == "joint" and figures.unit == "rad"
    if figures.ends is not None and math.isfinite(figures.ends[1] - figures.ends[0]):
        width = math.log(figures.ends[1] - figures.ends[0])
        if axis.drives == "cylinder":
            yield Measure("description", "ends", width, _log(2e-3, 10.0), 0.5, _log(5e-4, 20.0), _log(1e-4, 50.0))
        elif linear:
            yield Measure("description", "ends", width, _log(2e-3, 20.0), 0.7, _log(1e-4, 200.0))
        elif rotary:
            yield Measure("description", "ends", width, _log(0.05, 15.0), 0.7, _log(1e-3, 100.0))
        else:
            yield Measure("description", "ends", width, _log(2e-3, 20.0), 0.7, _log(1e-4, 200.0))
    if axis.actuation == "velocity":
        gain = math.log(figures.expected)
        if axis.drives == "cylinder":
            yield Measure("description", "expected", gain, _log(1e-3, 2.0), 0.7, _log(1e-4, 10.0), _log(1e-6, 50.0))
        elif linear:
            yield Measure("description", "expected", gain, _log(1e-3, 5.0), 0.7, _log(1e-5, 50.0))
        elif rotary:
            yield Measure("description", "expected", gain, _log(0.01, 15.0), 0.7, _log(1e-4, 1e3))
