"""What is expected of the figures of an axis: for each its usual range, the limits beyond which it is named, and its words.

The usual ranges come from the machines in ``datasets/``, the measured data in reports/measured_data/ and the simulated test
bench with hidden effects: over all of these the response of valve axes is 0.65 to 1.1 of ``gain``, that of servos 0.53 to 1.0
of the command, and no signal leaves its stroke or limits by more than 1 % of their width. The limits are far wider: a gain
that is off by a factor of two is an effect to be identified, not a mistake in a unit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from sysid.datasets.checks.figures import AxisFigures, SignalRange
from sysid.datasets.checks.finding import Evidence, interval, plain, ratio_text, with_unit
from sysid.datasets.quality.responses import Response

Limits = tuple[float, float]

#: Largest share of one measure in a cost [standard deviations]: one impossible figure does not outweigh all others.
MAX_EXCESS = 10.0
#: Cost at the ends of the usual range [nats]: it orders explanations that are otherwise equal.
PREFERENCE = 0.1
#: Least correlation for which a response is known, by actuation.
LEAST_STRENGTH = {"velocity": 0.5, "position": 0.7, "servo": 0.7, "force": 0.6}
#: Peak of the commands below which a dead-band may take most of them.
SMALL_PEAK = 0.5
UNLIMITED: Limits = (-math.inf, math.inf)


@dataclass(frozen=True)
class Measure:
    """One figure, its usual range, and the limits beyond which it is named.

    Args:
        kind: ``range``, ``response``, ``sign``, ``linkage``, ``description``, ``use`` or ``rate``.
        quantity: the signal's quantity, or the key of machine.toml.
        value: logarithm of a ratio, or a share.
        usual: range of honest data; ``sigma``: scale of distances from it.
        notice, severe: (low, high) beyond which the figure is named.
        evidence: what is said then.
    """

    kind: str
    quantity: str
    value: float
    usual: Limits
    sigma: float
    notice: Limits = UNLIMITED
    severe: Limits = UNLIMITED
    evidence: Callable[[], Evidence] | None = None

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


def _log(low: float, high: float) -> Limits:
    return math.log(low), math.log(high)


def measures_of(figures: AxisFigures) -> Iterator[Measure]:
    """All measures that are known for an axis."""
    axis = figures.axis
    if figures.command is not None and figures.command.peak > 0.0:
        if axis.actuation == "velocity":
            yield _full_scale(figures, figures.command)
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


def _full_scale(figures: AxisFigures, span: SignalRange) -> Measure:
    """Commands of a valve against ±1."""
    size, usual = math.log(span.peak), _log(0.1, 1.05)

    def evidence() -> Evidence:
        return Evidence(f"{figures.signal('command')} runs from {span.low:.4g} to {span.high:.4g}", "−1 to 1")

    sigma = 0.1 if size > usual[1] else 0.8
    return Measure("range", "command", size, usual, sigma, (-math.inf, usual[1]), _log(1e-9, 2.0), evidence)


def _response(figures: AxisFigures) -> Iterator[Measure]:
    """Motion against the command, and its size against the nominal response."""
    ratio, response, axis = figures.ratio, figures.response, figures.axis
    if ratio is None or response is None or response.strength < LEAST_STRENGTH[axis.actuation] or ratio == 0.0:
        return
    if ratio < 0.0:

        def against() -> Evidence:
            found = f"{axis.driven} moves against {figures.signal('command')} (correlation −{response.strength:.2f})"
            return Evidence(found, "motion in the direction of the command")

        yield Measure("sign", "response", 1.0, (0.0, 0.0), 0.1, (0.0, 0.0), (0.0, 0.0), against)
    small = figures.command is not None and figures.command.peak < SMALL_PEAK
    if axis.actuation == "force":
        usual, sigma, notice, severe = _log(0.3, 3.0), 0.5, _log(1 / 5, 5.0), _log(1 / 10, 10.0)
    elif axis.follows_positions:
        usual, sigma, notice, severe = _log(0.5, 1.1), 0.35, _log(1 / 5, 2.0), _log(1 / 8, 4.0)
    else:
        usual, sigma = _log(0.4, 1.5), 0.35
        notice, severe = _log(1 / 10 if small else 1 / 3, 3.0), _log(1 / 20 if small else 1 / 5, 5.0)
    size = math.log(abs(ratio))
    yield Measure("response", "response", size, usual, sigma, notice, severe, lambda: _response_evidence(figures, response))


def _response_evidence(figures: AxisFigures, response: Response) -> Evidence:
    axis, place = figures.axis, figures.driven_unit
    ratio = abs(figures.ratio or 1.0)
    if axis.actuation == "velocity":
        unit = f"{place}/s" if place else "1/s"
        found = f"{axis.driven} moves at {with_unit(abs(response.value), unit)} at full command"
        if "gain" in axis.estimated:
            return Evidence(found, f"about {with_unit(figures.expected, unit)} as in the other recordings")
        return Evidence(f"{found}, {ratio_text(ratio)} `gain`", f"about gain = {axis.gain:g}")
    if axis.follows_positions:
        return Evidence(f"{axis.driven} moves by {plain(ratio)} where {figures.signal('command')} moves by 1", "about 1")
    mass = with_unit(abs(response.value), "kg" if place == "m" else None)
    found = f"{axis.driven} accelerates as a mass or inertia of {mass} would, {ratio_text(ratio)} `inertia`"
    return Evidence(found, f"about {axis.inertia:g}")


def _reach(
    figures: AxisFigures, quantity: str, span: SignalRange, ends: Limits, notice: float = 0.1, severe: float = 0.75
) -> Iterator[Measure]:
    """Positions against stroke or limits, and the share of them that is used."""
    width = ends[1] - ends[0]
    if not (math.isfinite(width) and width > 0.0):
        return

    def evidence() -> Evidence:
        unit = figures.unit if quantity == "joint" else figures.driven_unit
        name = "stroke" if figures.axis.drives == "cylinder" and quantity == "driven" else "limits"
        found = f"{figures.signal(quantity)} runs from {span.low:.4g} to {with_unit(span.high, unit)}"
        return Evidence(found, f"{name} = {interval(*ends, unit)}")

    beyond = max(ends[0] - span.low, span.high - ends[1]) / width
    yield Measure("range", quantity, beyond, (-math.inf, 0.05), 0.1, (-math.inf, notice), (-math.inf, severe), evidence)
    if span.width > 0.0:
        moves = figures.response is not None and figures.response.strength > LEAST_STRENGTH[figures.axis.actuation]
        least = _log(0.003, math.inf) if moves and quantity != "command" else UNLIMITED
        yield Measure("use", quantity, math.log(span.width / width), _log(0.05, 1.05), 1.0, least, evidence=evidence)


def _linkage(figures: AxisFigures) -> Iterator[Measure]:
    """The joint against the cylinder through the linkage. Without one both use about the same share of their ranges, because
    the map is monotonic.
    """
    name = figures.axis.name
    if figures.pairs is not None:
        pairs = figures.pairs
        spread = float(np.ptp(pairs.joint))
        if spread > 0.0:
            error = pairs.joint - pairs.linkage.joint(pairs.cylinder)
            share = float(np.sqrt(np.mean(error**2))) / spread
            found = f"{name}.joint does not follow {name}.cylinder through `linkage`"
            apart = Evidence(found, f"the angle of the triangle of {name}")
            yield Measure("linkage", "joint", share, (0.0, 0.05), 0.05, (-1.0, 0.25), (-1.0, 0.75), lambda: apart)
    elif (shares := figures.shares) is not None and min(shares) > 0.0:
        stroke, joint = shares

        def evidence() -> Evidence:
            text = f"{name}.cylinder uses {100 * stroke:.3g} % of its stroke and {name}.joint {100 * joint:.3g} % of its limits"
            return Evidence(text, "similar shares")

        ratio = math.log(joint / stroke)
        yield Measure("linkage", "joint", ratio, _log(0.5, 2.0), 0.4, _log(1 / 6, 6.0), _log(1 / 20, 20.0), evidence)


#: What an axis drives (the unit of a joint), and key of machine.toml → usual range, its scale, and limits of notice and severe
#: [m, rad, or the same a second]: sizes that machines have.
_SIZES: dict[tuple[str | None, str], tuple[Limits, float, Limits, Limits]] = {
    ("cylinder", "ends"): (_log(2e-3, 10.0), 0.5, _log(5e-4, 20.0), _log(1e-4, 50.0)),
    ("m", "ends"): (_log(2e-3, 20.0), 0.7, _log(1e-4, 200.0), UNLIMITED),
    ("rad", "ends"): (_log(0.05, 15.0), 0.7, _log(1e-3, 100.0), UNLIMITED),
    (None, "ends"): (_log(2e-3, 20.0), 0.7, _log(1e-4, 200.0), UNLIMITED),
    ("cylinder", "expected"): (_log(1e-3, 2.0), 0.7, _log(1e-4, 10.0), _log(1e-6, 50.0)),
    ("m", "expected"): (_log(1e-3, 5.0), 0.7, _log(1e-5, 50.0), UNLIMITED),
    ("rad", "expected"): (_log(0.01, 15.0), 0.7, _log(1e-4, 1e3), UNLIMITED),
}


def _description(figures: AxisFigures) -> Iterator[Measure]:
    """Sizes in machine.toml that no machine has."""
    if figures.ends is not None and math.isfinite(figures.ends[1] - figures.ends[0]):
        yield from _size(figures, "ends", figures.ends[1] - figures.ends[0])
    if figures.axis.actuation == "velocity":
        yield from _size(figures, "expected", figures.expected)


def _size(figures: AxisFigures, key: str, size: float) -> Iterator[Measure]:
    axis, unit = figures.axis, figures.driven_unit or ""
    limits = _SIZES.get(("cylinder" if axis.drives == "cylinder" else figures.unit, key))
    if limits is None:
        return

    def evidence() -> Evidence:
        low, high = (plain(math.exp(edge)) for edge in limits[2])
        if key == "ends":
            assert figures.ends is not None
            text, usual = interval(*figures.ends, unit), f"a width between {low} and {high} {unit}"
            name = "stroke" if axis.drives == "cylinder" else "limits"
        else:
            name, text, usual = "gain", with_unit(axis.gain, f"{unit}/s"), f"{low} to {high} {unit}/s"
        return Evidence(f"{name} = {text} of axis {axis.name} in machine.toml", usual)

    yield Measure("description", key, math.log(size), *limits, evidence)
