"""A card: an actuator as it was identified from measured data, with the evidence, in a JSON file of this package.

``pipelines/actuator_cards.py`` makes the files in ``cards/`` from the raw logs by the gap workflow. The plant of a card has the
actuators alone: what they move, and what the recordings show of that, is left out and listed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Literal

from sysid.config import Strict, parse_settings
from sysid.errors import SettingsError, nearest
from sysid.gap.result import WrittenEffect
from sysid.machine.description import ServoLaw
from sysid.parse import parse_json
from sysid.plant import Plant, plant_from_files

FOLDER = Path(__file__).parent / "cards"
#: Before the name of a card, where a plant of a workspace could be meant too.
PREFIX = "actuators/"


@dataclass(frozen=True)
class CardData(Strict):
    """The recordings that a card is made from.

    Args:
        recipe: of the ingest, in this repository.
        dataset, digest: the dataset version.
        recordings: their names; ``held_out``: those of the errors.
        seconds: their duration together [s].
        conditions: supply, gains and load under which they were made.
    """

    source: str
    licence: str
    recipe: str
    dataset: str
    digest: str
    recordings: tuple[str, ...]
    held_out: tuple[str, ...]
    seconds: float
    conditions: tuple[str, ...]


@dataclass(frozen=True)
class CardError(Strict):
    """RMS error of a signal on held-out recordings: of the default values, of the card, and of the true model.

    Args:
        unit: of the signal and its errors [SI].
        floor_source: what the noise floor is from.
    """

    signal: str
    unit: str
    default: float
    card: float
    noise_floor: float
    floor_source: str


@dataclass(frozen=True)
class NotShown(Strict):
    """What the recordings do not show of an actuator, and why."""

    name: str
    targets: tuple[str, ...]
    why: str


@dataclass(frozen=True)
class Repetition(Strict):
    """One parameter, estimated again from recordings that the card's value is not from.

    Args:
        recordings: those of the estimate; ``kind``: of the value on the card.
        value: None where they do not show the effect.
        inside: whether the value lies in the interval of the card; ``overlaps``: whether the two intervals overlap.
    """

    recordings: str
    kind: str
    name: str
    target: str
    parameter: str
    value: float | None
    inside: bool
    overlaps: bool


@dataclass(frozen=True)
class CardReplay(Strict):
    """The exported card in a simulator on the held-out recordings: its error over that of the plant.

    Args:
        what: the whole export, or its defaults alone.
        signal: which is compared.
        ratio: error of the export over that of the plant; None where it was not run.
        why: it was not run, or what it lacks.
    """

    what: str
    signal: str = ""
    ratio: float | None = None
    why: str = ""


@dataclass(frozen=True)
class ActuatorCard(Strict):
    """A card.

    Args:
        default: the simulation that its errors are compared with.
        values: every effect that the repair writes, named, tied or adjusted without a name, with 95 % intervals.
        machine_only: effects of the machine that the actuators move, which the plant of the card does not contain.
        assumed: values of the plant that no recording shows.
        loops: actuator → position loop of its servo, as its logs and data sheet state it; it is not identified.
        beside: what is published, and what other data show of the same actuator.
        repeated: parameters from other recordings.
        plant: ``plant.json`` of the actuators alone.
        made: command, commit, date and versions.
    """

    schema: Literal[1]
    name: str
    title: str
    data: CardData
    default: str
    values: tuple[WrittenEffect, ...]
    errors: tuple[CardError, ...]
    plant: dict[str, Any]
    made: dict[str, Any]
    not_shown: tuple[NotShown, ...] = ()
    machine_only: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    loops: dict[str, ServoLaw] = field(default_factory=dict)
    beside: tuple[str, ...] = ()
    repeated: tuple[Repetition, ...] = ()
    replays: tuple[CardReplay, ...] = ()

    @cached_property
    def model(self) -> Plant:
        """The plant of the actuators alone, with the joint distribution of its parameters."""
        return plant_from_files({"plant.json": json.dumps(self.plant).encode()}, f"{PREFIX}{self.name}")

    @property
    def axes(self) -> tuple[str, ...]:
        """The actuators that it describes."""
        return self.model.machine.axis_names

    def assumes_inertia(self, axis: str) -> bool:
        """Whether the inertia of an actuator is assumed."""
        return any(text.startswith(f"inertia of {axis}:") for text in self.assumed)

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def card_from(values: Mapping[str, Any], where: object) -> ActuatorCard:
    """The card of the values of its JSON file.

    Raises:
        SettingsError: a key is missing, unknown or of the wrong type.
    """
    return parse_settings(dict(values), ActuatorCard, where)


@cache
def card_names() -> tuple[str, ...]:
    """Names of the cards of this release."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.json")))


def is_card(reference: str) -> bool:
    """Whether a reference to a plant is that of a card: ``actuators/NAME``, or the name of one."""
    return reference.startswith(PREFIX) or reference in card_names()


def card_named(reference: str) -> ActuatorCard:
    """The card ``NAME`` or ``actuators/NAME``.

    Raises:
        SettingsError: no card has that name.
    """
    name = reference.removeprefix(PREFIX)
    if name not in card_names():
        raise SettingsError("sysid actuators", f"no card {name!r}", nearest(name, card_names()))
    path = FOLDER / f"{name}.json"
    return card_from(parse_json(path.read_bytes()), path.name)
