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
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from sysid.datasets.plausibility.figures import AxisFigures, Span, cost_of
from sysid.datasets.plausibility.finding import Cause, factor_text
from sysid.signals import axis_signal


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
MOST = 3


@dataclass(frozen=True)
class Explanation:
    """A mistake on one axis.

    Args:
        key: quantity and factor, equal for equal mistakes of different axes.
        correct: figures → figures without the mistake.
        text: in words, with ``{signal}`` or ``{axes}`` for what it is about; ``remedy``: what to do.
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
    return tuple(unique.values())[:MOST]


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
        yield from _file(figures, "command", units)
        if axis.actuation == "velocity":
            yield from _neutral(figures, figures.command)
    if figures.driven is not None:
        yield from _file(figures, "driven", places)
        if figures.ends is not None:
            yield from _shifted(figures, figures.driven, figures.ends)
    if figures.joint is not None:
        yield from _file(figures, "joint", _units(figures.unit))
        yield _exchanged(figures)
    if axis.follows_positions and figures.command is not None and figures.driven is not None:
        yield from _both_signals(figures, places)
    yield from _description(figures, places)
    if figures.response is not None and not axis.follows_positions:
        for mistake in TIME:
            says = f"in {mistake.is_}, but were read as {mistake.read_as} ({factor_text(mistake.factor)})"
            remedy = f'Set `time_unit = "{_time_unit(mistake.is_)}"` in the recipe'
            cause = Cause("the time stamps", (), says, mistake.factor, remedy)
            yield _single(("time",), mistake.factor, mistake.rarity + 0.5, cause)


def _units(unit: str | None) -> tuple[UnitMistake, ...]:
    return {"rad": ANGLE, "m": LENGTH}.get(unit or "", (*LENGTH, *ANGLE))


def _single(quantities: tuple[str, ...], factor: float, rarity: float, cause: Cause) -> Explanation:
    def correct(figures: AxisFigures) -> AxisFigures:
        for quantity in quantities:
            figures = figures.corrected(quantity, factor)
        return figures

    return Explanation(("+".join(quantities), factor), PRIOR + rarity, correct, cause)


def signal_of(figures: AxisFigures, quantity: str) -> str:
    """The signal of a quantity: ``driven`` → ``boom.cylinder``."""
    return figures.axis.driven if quantity == "driven" else axis_signal(figures.axis.name, quantity)


def _file(figures: AxisFigures, quantity: str, units: tuple[UnitMistake, ...]) -> Iterator[Explanation]:
    """A signal in the log has another unit, or another sign."""
    signal = signal_of(figures, quantity)
    for mistake in units:
        says = f"in {mistake.is_}, but read as {mistake.read_as} ({factor_text(mistake.factor)})"
        if mistake in COMMAND and quantity == "command":
            span = mistake.factor if mistake.factor > 1.0 else None
            remedy = f"Set `span = {span:g}` in the recipe" if span else "Remove `span`, or the unit %, in the recipe"
        else:
            remedy = f'Set `unit = "{_unit_key(mistake.is_)}"` in the recipe'
        yield _single((quantity,), mistake.factor, mistake.rarity, Cause("", (signal,), says, mistake.factor, remedy))
    cause = Cause("", (signal,), "of the opposite sign", -1.0, "Set `sign = -1` in the recipe")
    yield _single((quantity,), -1.0, 0.0, cause)


def _both_signals(figures: AxisFigures, units: tuple[UnitMistake, ...]) -> Iterator[Explanation]:
    both = tuple(signal_of(figures, quantity) for quantity in ("command", "driven"))
    for mistake in units:
        says = f"in {mistake.is_}, but read as {mistake.read_as} ({factor_text(mistake.factor)})"
        remedy = f'Set `unit = "{_unit_key(mistake.is_)}"` in the recipe'
        yield _single(
            ("command", "driven"), mistake.factor, mistake.rarity + 0.5, Cause("", both, says, mistake.factor, remedy)
        )


def _description(figures: AxisFigures, places: tuple[UnitMistake, ...]) -> Iterator[Explanation]:
    """Another unit in machine.toml or in the URDF."""
    axis = figures.axis
    ends = "stroke" if axis.drives == "cylinder" else "limits"
    speeds = LINEAR_SPEED if axis.drives == "cylinder" or figures.unit == "m" else ROTATION_SPEED
    if figures.response is not None and not axis.follows_positions and "gain" not in axis.estimated:
        key, units = ("inertia", INERTIA) if axis.actuation == "force" else ("gain", speeds)
        for mistake in units:
            yield _described(axis.name, (key,), ("expected",), mistake, "/s" if key == "gain" else "")
    if figures.ends is not None:
        for mistake in places:
            yield _described(axis.name, (ends,), ("ends",), mistake)
            if figures.response is not None and axis.actuation == "velocity" and "gain" not in axis.estimated:
                yield _described(axis.name, ("gain", ends), ("expected", "ends"), mistake)
    if figures.joint_ends is not None and figures.joint is not None:
        for mistake in _units(figures.unit):
            yield _described(axis.name, ("limits",), ("joint_ends",), mistake)


def _described(
    axis: str, keys: tuple[str, ...], quantities: tuple[str, ...], mistake: UnitMistake, per: str = ""
) -> Explanation:
    names = " and ".join(f"`{key}`" for key in keys)
    per = "" if mistake.is_ == "rpm" or "/" in mistake.is_ else per
    what = factor_text(mistake.factor)
    if mistake.factor > 1.0:
        what = f"in {mistake.is_}{per} instead of {mistake.read_as}{per} ({what})"
    place = "machine.toml or the URDF" if keys == ("limits",) else "machine.toml"
    about = f"{names} in {place} of axis"
    cause = Cause(about, (axis,), what, mistake.factor, f"Write {names} in SI units")
    # Values in machine.toml are SI by definition: too small a value takes a conversion that was done twice.
    return _single(quantities, mistake.factor, mistake.rarity + (0.5 if mistake.factor < 1.0 else 0.0), cause)


def _neutral(figures: AxisFigures, command: Span) -> Iterator[Explanation]:
    """A command with its neutral value away from zero: a duty cycle, a pulse width, counts of a converter."""
    half = max(command.high - command.rest, command.rest - command.low)
    if not abs(command.rest) > 0.2 * half > 0.0:
        return
    signal = signal_of(figures, "command")
    says = f"a raw value with its neutral point at {command.rest:.5g}, not a command between −1 and 1"
    remedy = f"Set `zero = {command.rest:.6g}` and `span = {half:.4g}` in the recipe"

    def correct(figures: AxisFigures) -> AxisFigures:
        scaled = figures.corrected("command", half)
        return replace(scaled, command=Span((command.low - command.rest) / half, (command.high - command.rest) / half, 0.0))

    yield Explanation(("command", half), PRIOR, correct, Cause("", (signal,), says, half, remedy))


def _shifted(figures: AxisFigures, span: Span, ends: tuple[float, float]) -> Iterator[Explanation]:
    """Values from another zero."""
    if span.width > 1.05 * (ends[1] - ends[0]):
        return
    shift = ends[0] - span.low if span.low < ends[0] else ends[1] - span.high
    signal = signal_of(figures, "driven")
    remedy = f"Correct `offset` or `zero` in the recipe (a shift of {shift:+.4g} would just suffice)"

    def correct(figures: AxisFigures) -> AxisFigures:
        moved = Span(span.low + shift, span.high + shift, span.rest + shift)
        pairs = figures.pairs
        pairs = None if pairs is None else replace(pairs, cylinder=pairs.cylinder + shift)
        return replace(figures, driven=moved, pairs=pairs)

    yield Explanation(("offset", 0.0), PRIOR, correct, Cause("", (signal,), "counted from another zero", 1.0, remedy))


def _exchanged(figures: AxisFigures) -> Explanation:
    name = figures.axis.name
    columns = (f"{name}.cylinder", f"{name}.joint")
    cause = Cause("the columns", columns, "exchanged", 1.0, "Exchange the fields in the recipe")
    return Explanation(("exchanged", 1.0), PRIOR, AxisFigures.exchanged, cause)


def _unit_key(unit: str) -> str:
    """The spelling of a unit in a recipe."""
    word = unit.partition(" ")[0]
    return {"degrees": "deg", "turns": "turn", "encoder": "turn"}.get(word, word)


def _time_unit(unit: str) -> str:
    return {"µs": "us"}.get(unit, unit)
