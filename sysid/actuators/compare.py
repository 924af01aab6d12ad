"""Values of a user's actuator beside those of a card."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from sysid.actuators.card import ActuatorCard
from sysid.display import number
from sysid.effects import effect_named
from sysid.effects.wording import title_of
from sysid.figures import ParameterFigure, Table
from sysid.gap.result import WrittenEffect


@dataclass(frozen=True)
class ComparedValue:
    """One parameter of an actuator and of a card.

    Args:
        target: the user's axis; ``value``, ``interval95``: what was identified there.
        card: the value of the actuator of the same name, else the median over those of the card.
        lowest, highest: ends of the intervals of the card, over its actuators.
        overlap: whether the intervals of both overlap.
    """

    name: str
    target: str
    parameter: str
    unit: str
    value: float
    interval95: tuple[float, float]
    card: float
    lowest: float
    highest: float
    overlap: bool

    @property
    def ratio(self) -> float:
        """The user's value over that of the card."""
        return self.value / self.card if self.card else float("nan")


def compared(card: ActuatorCard, written: Sequence[WrittenEffect]) -> Iterator[ComparedValue]:
    """The parameters of drives that a result of the gap workflow writes and the card has as well, both with intervals."""
    for item in written:
        if effect_named(item.name).target != "axis":
            continue  # a sensor is another one in each machine
        same = [own for own in card.values if (own.name, own.side) == (item.name, item.side)]
        same = [own for own in same if own.target == item.target] or same
        for key, ends in item.interval95.items():
            unit, value = item.units.get(key, ""), item.parameters[key]
            theirs = [own for own in same if own.units.get(key, "") == unit and key in own.interval95]
            if not theirs or not isinstance(value, float):
                continue
            low, high = (float(end) for end in ends)  # type: ignore[arg-type]
            around = [float(end) for own in theirs for end in own.interval95[key]]  # type: ignore[arg-type]
            overlap = low <= max(around) and high >= min(around)
            middle = statistics.median(float(own.parameters[key]) for own in theirs)
            bounds = min(around), max(around)
            yield ComparedValue(item.name, item.target, key, unit, value, (low, high), middle, *bounds, overlap)


def comparison_table(card: ActuatorCard, rows: Sequence[ComparedValue]) -> Table:
    """The user's value, that of the card, and their ratio."""
    cells = []
    for row in rows:
        own = ParameterFigure(row.parameter, row.unit, row.value, row.interval95)
        theirs = ParameterFigure(row.parameter, row.unit, row.card, (row.lowest, row.highest))
        title = f"{title_of(effect_named(row.name), row.target, None)} of {row.target}, {own.label}"
        ratio = f"{number(row.ratio, 2)}×"
        cells.append((title, own.text, f"{theirs.text} ({theirs.interval})", ratio, "" if row.overlap else "intervals apart"))
    empty = f"None of the values is on the card {card.name}."
    return Table(("effect", "yours", f"card {card.name}", "ratio", ""), tuple(cells), right=(3,), empty=empty)
