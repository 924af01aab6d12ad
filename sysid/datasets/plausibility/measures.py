"""What is expected of the figures of an axis: for each a usual range, and limits beyond which it is named.

The usual ranges come from the machines in ``datasets/``, the measured data in docs/measured-data.md and the simulated test
bench with hidden effects: over all of these the response of valve axes is 0.65 to 1.1 of ``gain``, that of servos 0.53 to 1.0
of the command, and no signal leaves its stroke or limits by more than 1 % of their width. The limits are far wider: a gain
that is off by a factor of two is an effect to be identified, not a mistake in a unit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sysid.datasets.plausibility.figures import AxisFigures, Span

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
