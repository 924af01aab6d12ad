"""Mistakes in units and signs: the list of factors by quantity, and those that explain implausible figures of an axis.

A factor is by how much the value as read is too large. ``mm`` read as ``m`` is too large by 1000.

Every mistake of the list changes the figures in a known way: millimetres read as metres raise range, speed and use of
the stroke together; a gain in mm/s lowers the ratio of speed and gain alone. A mistake explains the figures if they are usual
without it. Mistakes are compared by the cost of the corrected figures and their own rarity; those that the data cannot tell
apart are all named. Two mistakes at once are tried where one is not enough.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from sysid.datasets.checks.figures import AxisFigures, SignalRange
from sysid.datasets.checks.finding import Cause, exchanged_columns, factor_text, opposite_sign
from sysid.datasets.checks.measures import cost_of


@dataclass(frozen=True)
class UnitMistake:
    """A unit that was taken for another.

    Args:
        factor: value as read / true value.
        is_, read_as: the unit that the numbers have, and the one that was assumed.
        rarity: how unlikely it is beside the other mistakes in the list [nats].
    """

    factor: float
    is_: str
    read_as: str
    rarity: float = 0.0

    @property
    def inverse(self) -> UnitMistake:
        return UnitMistake(1.0 / self.factor, self.read_as, self.is_, self.rarity + 0.5)

    def cause(self, *signals: str, remedy: str = "") -> Cause:
        """Signals with this mistake."""
        says = f"in {self.is_}, but read as {self.read_as} ({factor_text(self.factor)})"
        return Cause("", signals, says, self.factor, remedy)

    @property
    def time_cause(self) -> Cause:
        """Stamps with this mistake."""
        says = f"in {self.is_}, but were read as {self.read_as} ({factor_text(self.factor)})"
        unit = {"µs": "us"}.get(self.is_, self.is_)
        return Cause("the time stamps", (), says, self.factor, f'Set `time_unit = "{unit}"` in the recipe')

    @property
    def unit_remedy(self) -> str:
        word = self.is_.partition(" ")[0]
        return f'Set `unit = "{_UNIT_KEYS.get(word, word)}"` in the recipe'

    def distance(self, factor: float, weight: float) -> float:
        """Of a factor from this one, with ``weight`` times the rarity [nats]."""
        return abs(math.log(factor / self.factor)) + weight * self.rarity


#: The spelling of units in a recipe.
_UNIT_KEYS = {"degrees": "deg", "turns": "turn", "encoder": "turn"}


def _both(*mistakes: UnitMistake) -> tuple[UnitMistake, ...]:
    return (*mistakes, *(mistake.inverse for mistake in mistakes))


DEGREES = 180.0 / math.pi

LENGTH = _both(
    UnitMistake(1000.0, "mm", "m"),
    UnitMistake(100.0, "cm", "m"),
    UnitMistake(10.0, "mm", "cm"),
    UnitMistake(1e6, "µm", "m", 2.0),
    UnitMistake(39.37, "inch", "m", 2.0),
)
ANGLE = _both(
    UnitMistake(DEGREES, "degrees", "rad"),
    UnitMistake(2.0 * math.pi, "rad", "turns", 1.0),
    UnitMistake(1000.0, "mrad", "rad", 1.0),
    UnitMistake(4096.0 / (2.0 * math.pi), "encoder counts (4096 a turn)", "rad", 2.0),
)
#: Speeds, as in ``gain``: per minute as well as in another unit.
ROTATION_SPEED = (*ANGLE, *_both(UnitMistake(60.0 / (2.0 * math.pi), "rpm", "rad/s", 1.0)))
LINEAR_SPEED = (*LENGTH, *_both(UnitMistake(60.0, "m/min", "m/s", 2.0)))
#: A command between −1 and 1, in the units of converters, buses and operators; full scale as the factor.
COMMAND = (
    UnitMistake(100.0, "per cent", "a fraction"),
    UnitMistake(0.01, "a fraction", "per cent", 0.5),
    UnitMistake(1000.0, "per mille", "a fraction", 1.0),
    UnitMistake(0.001, "a fraction", "per mille", 1.5),
    UnitMistake(10.0, "volts (full scale 10 V)", "a fraction", 1.5),
    UnitMistake(127.0, "counts of 8 bits", "a fraction", 1.5),
    UnitMistake(255.0, "counts (full scale 255)", "a fraction", 1.5),
    UnitMistake(1023.0, "counts (full scale 1023)", "a fraction", 2.0),
    UnitMistake(2047.0, "counts of 12 bits", "a fraction", 1.5),
    UnitMistake(4095.0, "counts (full scale 4095)", "a fraction", 1.5),
    UnitMistake(32767.0, "counts of 16 bits", "a fraction", 1.5),
)
FORCE = _both(
    UnitMistake(1000.0, "N", "kN"),
    UnitMistake(100.0, "N·cm", "N·m", 1.0),
    UnitMistake(9.80665, "N", "kgf", 1.0),
)
INERTIA = (
    UnitMistake(0.001, "t", "kg"),
    UnitMistake(1000.0, "g", "kg"),
    UnitMistake(1e4, "kg·cm²", "kg·m²", 1.0),
    UnitMistake(1e6, "kg·mm²", "kg·m²", 1.5),
    UnitMistake(1e7, "g·cm²", "kg·m²", 1.5),
)
TIME = _both(
    UnitMistake(1e3, "ms", "s"),
    UnitMistake(1e6, "µs", "s"),
    UnitMistake(1e9, "ns", "s"),
    UnitMistake(60.0, "s", "min", 2.0),
)

#: Cost of a mistake [nats], and of a second one at the same time.
PRIOR, SECOND = 3.0, 3.0
#: Mistakes within this of the best one are named with it [nats]; a better explanation than none has to gain :data:`GAIN`.
TIED, GAIN = 2.5, 4.0
#: A second mistake is tried where this cost is left after the best single one.
LEFT = 8.0
#: Most alternatives that are named.
MOST_CAUSES = 3


@dataclass(frozen=True)
class Explanation:
    """A mistake on one axis.

    Args:
        key: quantity and factor, equal for equal mistakes of different axes.
        correct: figures → figures without the mistake.
        cause: in words, with what to do.
    """

    key: tuple[str, float]
    prior: float
    correct: Callable[[AxisFigures], AxisFigures]
    cause: Cause


def explanations_of(figures: AxisFigures) -> tuple[Explanation, ...]:
    """The likeliest explanations of implausible figures, best first; empty where no listed mistake explains them."""
    candidates = list(_candidates(figures))
    costs = [(candidate.prior + cost_of(candidate.correct(figures)), candidate) for candidate in candidates]
    nothing = cost_of(figures)
    best, chosen = min(costs, key=lambda item: item[0], default=(nothing, None))
    if chosen is not None and best - chosen.prior > LEFT:
        pairs = [_together(a, b) for a, b in itertools.combinations(candidates, 2) if a.key[0] != b.key[0]]
        costs += [(pair.prior + cost_of(pair.correct(figures)), pair) for pair in pairs]
        best = min(cost for cost, _ in costs)
    if best > nothing - GAIN:
        return ()
    costs.sort(key=lambda item: item[0])
    tied = [candidate for cost, candidate in costs if cost <= best + TIED]
    unique = {candidate.cause.text: candidate for candidate in tied}
    return tuple(unique.values())[:MOST_CAUSES]


def _together(a: Explanation, b: Explanation) -> Explanation:
    remedy = ". ".join(filter(None, (a.cause.remedy, b.cause.remedy)))
    cause = replace(a.cause, says=f"{a.cause.says}, and {b.cause.text}", remedy=remedy)
    key = (f"{a.key[0]}+{b.key[0]}", a.key[1])
    return Explanation(key, a.prior + b.prior + SECOND, lambda f: b.correct(a.correct(f)), cause)


def _candidates(figures: AxisFigures) -> Iterator[Explanation]:
    axis = figures.axis
    places = _units(figures.unit) if axis.drives == "joint" else LENGTH
    if figures.command is not None:
        units = {"velocity": COMMAND, "position": places, "servo": places, "force": FORCE}[axis.actuation]
        yield from _in_file(figures, ("command",), units)
        if axis.actuation == "velocity":
            yield from _neutral(figures, figures.command)
    if figures.driven is not None:
        yield from _in_file(figures, ("driven",), places)
        if figures.ends is not None:
            yield from _shifted(figures, figures.driven, figures.ends)
    if figures.joint is not None:
        yield from _in_file(figures, ("joint",), _units(figures.unit))
        columns = exchanged_columns(f"{axis.name}.cylinder", f"{axis.name}.joint", remedy="Exchange the fields in the recipe")
        yield Explanation(("exchanged", 1.0), PRIOR, AxisFigures.exchanged, columns)
    if axis.follows_positions and figures.command is not None and figures.driven is not None:
        yield from _in_file(figures, ("command", "driven"), places)
    yield from _in_description(figures, places)
    if figures.response is not None and not axis.follows_positions:
        for mistake in TIME:
            yield _mistake(("time",), mistake.factor, mistake.rarity + 0.5, mistake.time_cause)


def _units(unit: str | None) -> tuple[UnitMistake, ...]:
    return {"rad": ANGLE, "m": LENGTH}.get(unit or "", (*LENGTH, *ANGLE))


def _mistake(quantities: tuple[str, ...], factor: float, rarity: float, cause: Cause) -> Explanation:
    """Some quantities are too large by a factor."""

    def correct(figures: AxisFigures) -> AxisFigures:
        for quantity in quantities:
            figures = figures.corrected(quantity, factor)
        return figures

    return Explanation(("+".join(quantities), factor), PRIOR + rarity, correct, cause)


def _in_file(figures: AxisFigures, quantities: tuple[str, ...], units: Sequence[UnitMistake]) -> Iterator[Explanation]:
    """One or two signals in the log have another unit; or one has another sign."""
    signals = [figures.signal(quantity) for quantity in quantities]
    for mistake in units:
        remedy = mistake.unit_remedy
        if mistake in COMMAND and quantities == ("command",):
            span = mistake.factor if mistake.factor > 1.0 else None
            remedy = f"Set `span = {span:g}` in the recipe" if span else "Remove `span`, or the unit %, in the recipe"
        rarity = mistake.rarity + (0.5 if len(quantities) > 1 else 0.0)
        yield _mistake(quantities, mistake.factor, rarity, mistake.cause(*signals, remedy=remedy))
    if len(quantities) == 1:
        yield _mistake(quantities, -1.0, 0.0, opposite_sign(*signals))


def _in_description(figures: AxisFigures, places: Sequence[UnitMistake]) -> Iterator[Explanation]:
    """Another unit in machine.toml or in the URDF."""
    axis = figures.axis
    ends = "stroke" if axis.drives == "cylinder" else "limits"
    speeds = LINEAR_SPEED if axis.drives == "cylinder" or figures.unit == "m" else ROTATION_SPEED
    stated = figures.response is not None and "gain" not in axis.estimated
    if stated and axis.actuation == "force":
        yield from (_described(figures, {"inertia": "expected"}, mistake) for mistake in INERTIA)
    elif stated and not axis.follows_positions:
        yield from (_described(figures, {"gain": "expected"}, mistake, "/s") for mistake in speeds)
    if figures.ends is not None:
        for mistake in places:
            yield _described(figures, {ends: "ends"}, mistake)
            if stated and axis.actuation == "velocity":
                yield _described(figures, {"gain": "expected", ends: "ends"}, mistake)
    if figures.joint_ends is not None and figures.joint is not None:
        yield from (_described(figures, {"limits": "joint_ends"}, mistake) for mistake in _units(figures.unit))


def _described(figures: AxisFigures, keys: dict[str, str], mistake: UnitMistake, per: str = "") -> Explanation:
    """A unit in the description.

    Args:
        keys: of machine.toml → field of the figures.
        per: after the units, such as ``/s``.
    """
    names = " and ".join(f"`{key}`" for key in keys)
    per = "" if mistake.is_ == "rpm" or "/" in mistake.is_ else per
    what = factor_text(mistake.factor)
    if mistake.factor > 1.0:
        what = f"in {mistake.is_}{per} instead of {mistake.read_as}{per} ({what})"
    place = "machine.toml or the URDF" if list(keys) == ["limits"] else "machine.toml"
    cause = Cause(f"{names} in {place} of axis", (figures.axis.name,), what, mistake.factor, f"Write {names} in SI units")
    # Values in machine.toml are SI by definition: too small a value takes a conversion that was done twice.
    rarity = mistake.rarity + (0.5 if mistake.factor < 1.0 else 0.0)
    return _mistake(tuple(keys.values()), mistake.factor, rarity, cause)


def _neutral(figures: AxisFigures, command: SignalRange) -> Iterator[Explanation]:
    """A command with its neutral value away from zero: a duty cycle, a pulse width, counts of a converter."""
    half = max(command.high - command.rest, command.rest - command.low)
    if not abs(command.rest) > 0.2 * half > 0.0:
        return
    says = f"a raw value with its neutral point at {command.rest:.5g}, not a command between −1 and 1"
    remedy = f"Set `zero = {command.rest:.6g}` and `span = {half:.4g}` in the recipe"

    def correct(figures: AxisFigures) -> AxisFigures:
        scaled = figures.corrected("command", half)
        return replace(
            scaled, command=SignalRange((command.low - command.rest) / half, (command.high - command.rest) / half, 0.0)
        )

    yield Explanation(("command", half), PRIOR, correct, Cause("", (figures.signal("command"),), says, half, remedy))


def _shifted(figures: AxisFigures, span: SignalRange, ends: tuple[float, float]) -> Iterator[Explanation]:
    """Values from another zero."""
    if span.width > 1.05 * (ends[1] - ends[0]):
        return
    shift = ends[0] - span.low if span.low < ends[0] else ends[1] - span.high
    remedy = f"Correct `offset` or `zero` in the recipe (a shift of {shift:+.4g} would just suffice)"

    def correct(figures: AxisFigures) -> AxisFigures:
        moved = SignalRange(span.low + shift, span.high + shift, span.rest + shift)
        pairs = figures.pairs and replace(figures.pairs, cylinder=figures.pairs.cylinder + shift)
        return replace(figures, driven=moved, pairs=pairs)

    cause = Cause("", (figures.signal("driven"),), "counted from another zero", 1.0, remedy)
    yield Explanation(("offset", 0.0), PRIOR, correct, cause)
