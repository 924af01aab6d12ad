"""A card in words and tables, for console and documentation, and beside the values of a user's actuator."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from sysid.actuators.card import ActuatorCard, CardData, CardError
from sysid.display import number, quantity, signal_name
from sysid.effects import effect_named
from sysid.effects.catalogue import BY_NAME
from sysid.effects.wording import title_of
from sysid.figures import ParameterFigure, Table
from sysid.gap.result import WrittenEffect
from sysid.names import listed

KINDS = {"named": "named", "tied": "one of a tie", "adjusted": "no name"}
#: Errors without a name, in a list of what the data do not show.
UNNAMED = "unnamed"
#: Targets that are listed one by one.
TARGETS = 6


def data_text(data: CardData) -> str:
    """``4 recordings, 6.2 min``."""
    count = len(data.recordings)
    return f"{count} recording{'' if count == 1 else 's'}, {data.seconds / 60.0:.1f} min"


def main_error(card: ActuatorCard) -> CardError:
    """Of the signals whose default error is largest against its noise floor; a force before the motion that it makes."""
    forces = [item for item in card.errors if item.signal.endswith(".command")]
    return max(forces or card.errors, key=lambda item: item.default / max(item.noise_floor, 1e-300))


def error_text(card: ActuatorCard) -> str:
    """The main error: ``slide command 38.6 N → 1.52 N``."""
    item = main_error(card)
    return f"{signal_name(item.signal)} {quantity(item.default, item.unit)} → {quantity(item.card, item.unit)}"


def value_table(card: ActuatorCard) -> Table:
    """A row for every parameter of the card."""
    rows: list[tuple[str, ...]] = []
    for item in sorted(card.values, key=lambda item: item.kind != "named"):
        title = f"{_title(card, item.name, item.target)} of {item.target.removesuffix('.joint')}"
        for place, (key, value) in enumerate(item.parameters.items()):
            figure = ParameterFigure(key, item.units.get(key, ""), value, item.interval95.get(key))
            first = (title, KINDS[item.kind]) if place == 0 else ("", "")
            rows.append((first[0], f"{figure.label} {figure.text}", figure.interval, first[1]))
    return Table(("effect", "value", "95 % interval", ""), tuple(rows))


def unnamed_sentences(card: ActuatorCard) -> Iterator[str]:
    """Why values have no name, by reason."""
    reasons: dict[str, list[str]] = {}
    for item in card.values:
        if item.kind == "adjusted":
            text = f"{_title(card, item.name, item.target)} of {item.target.removesuffix('.joint')}"
            reasons.setdefault(item.why, []).append(text)
    for why, titles in reasons.items():
        yield f"No name, because {why}: {', '.join(titles)}."


def error_table(card: ActuatorCard) -> Table:
    """Held-out errors of default and card beside the noise floor."""
    rows = []
    for item in card.errors:
        numbers = (quantity(value, item.unit) for value in (item.default, item.card, item.noise_floor))
        closable = item.default - item.noise_floor
        closed = f"{100.0 * (item.default - item.card) / closable:.0f} %" if closable > 0.0 else "–"
        rows.append((signal_name(item.signal), *numbers, closed))
    return Table(("held-out error", "default", "card", "noise floor", "closed"), tuple(rows), right=(1, 2, 3, 4))


def remarks(card: ActuatorCard) -> dict[str, list[str]]:
    """What the data did not show, values from other recordings, replays and what the plant of the card lacks; none is empty."""
    unseen: dict[str, list[str]] = {}
    for item in card.not_shown:
        if item.name != UNNAMED:
            text = f"{_title(card, item.name, item.targets[0])} ({listed(item.targets, TARGETS)})"
            unseen.setdefault(item.why, []).append(text)
    found = {
        "Not shown by these data": [f"{why}: {', '.join(texts)}" for why, texts in unseen.items()],
        "Errors without a name": [f"{listed(i.targets)}: {i.why}" for i in card.not_shown if i.name == UNNAMED],
        "Again from recordings that the values are not from": [repetition_text(card)] if card.repeated else [],
        "Published, and from other data": list(card.beside),
        "Exported and replayed, error over that of the plant": list(_replays(card)),
        "Position loop, from logs and data sheet": [
            f"{axis}: kp {loop.kp:.3g}, force limit {loop.force_range[1]:.3g}" for axis, loop in card.loops.items()
        ],
        "Inertia of force drives, adjusted with the links or stated, without an interval": list(_inertias(card)),
        "Assumed": list(card.assumed),
        "Of the machine, not of the actuator, and left out": [", ".join(card.machine_only)] if card.machine_only else [],
    }
    return {heading: texts for heading, texts in found.items() if texts}


def repetition_text(card: ActuatorCard) -> str:
    """How many values from other recordings lie in the intervals of the card, and have intervals that overlap with them."""
    parts = []
    for kind, word in (("named", "named"), ("tied", "tied"), ("adjusted", "without a name")):
        own = [item for item in card.repeated if item.kind == kind]
        if own:
            inside, overlapping = sum(item.inside for item in own), sum(item.overlaps for item in own)
            missing = sum(item.value is None for item in own)
            absent = f", {missing} not found" if missing else ""
            parts.append(f"{word}: {inside} of {len(own)} in the interval, {overlapping} overlapping{absent}")
    return "; ".join(parts)


def _inertias(card: ActuatorCard) -> Iterator[str]:
    for axis in card.model.machine.axes:
        if axis.actuation == "force" and not card.assumes_inertia(axis.name):
            yield f"{axis.name} {quantity(axis.inertia or 0.0, 'kg' if axis.joint_type == 'prismatic' else 'kg·m²')}"


def _replays(card: ActuatorCard) -> Iterator[str]:
    for item in card.replays:
        figure = f"{item.ratio:.3f} ({signal_name(item.signal)})" if item.ratio is not None else "not run"
        yield f"{item.what}: {figure}{f'; {item.why}' if item.why else ''}"


def _title(card: ActuatorCard, name: str, target: str) -> str:
    return title_of(effect_named(name), target, card.model.machine) if name in BY_NAME else name.replace("_", " ")


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
