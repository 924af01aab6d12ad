"""``sysid actuators``: the cards of identified actuators."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from sysid.cli.datasets import ReferenceGroup
from sysid.cli.output import Printer, command, json_option

if TYPE_CHECKING:
    from sysid.actuators import ActuatorCard

#: Recordings whose names are listed.
RECORDINGS = 6


@click.group(cls=ReferenceGroup, subcommand_metavar="[show NAME]")
def actuators() -> None:
    """List the cards of identified actuators, or show one.

    A card has what was identified from measured data, with 95 % intervals, on which data, what the data did not show, and the
    held-out error beside that of the default values. `sysid export actuators/NAME --to TARGET` writes one for a simulator.
    """


@actuators.command()
@click.argument("name", metavar="NAME", required=False)
@json_option
def show(name: str | None, out: Printer) -> None:
    """List the cards, or show one."""
    from sysid.actuators import card_named, card_names

    if name is not None:
        card = card_named(name)
        _show(out, card)
        out.json(card.to_json())
        return
    cards = [card_named(each) for each in card_names()]
    out.json({"schema": 1, "cards": [card.to_json() for card in cards]})
    out.table(("name", "what", "data", "held-out error: default → card"), [_row(card) for card in cards])
    out.line(f"{command('actuators', 'show', 'NAME')} shows one.")


def _row(card: ActuatorCard) -> Sequence[str]:
    from sysid.actuators.words import data_text, error_text

    return card.name, card.title, data_text(card.data), error_text(card)


def _show(out: Printer, card: ActuatorCard) -> None:
    from sysid.actuators import words
    from sysid.names import listed

    out.line(f"{card.name}: {card.title}")
    out.line()
    data = card.data
    out.entry(f"Data: {data.source} (licence: {data.licence}), {words.data_text(data)}. Recipe: {data.recipe}.")
    for text in data.conditions:
        out.entry(text, "  - ")
    out.show(words.value_table(card))
    for text in words.unnamed_sentences(card):
        out.entry(text)
    out.show(words.error_table(card))
    out.entry(f"Default: {card.default}. Held out: {listed(data.held_out, RECORDINGS)}.")
    for heading, texts in words.remarks(card).items():
        out.line()
        out.line(f"{heading}:")
        for text in texts:
            out.entry(textwrap.shorten(text, 400, placeholder=" …"), "- ")
    out.line()
    out.entry(f"Made by {card.made['command']} (commit {card.made['commit']}, {card.made['date']}) from {data.dataset}.")
    out.line(command("export", f"actuators/{card.name}", "--to", "mjcf", "--out", card.name))
