"""``sysid export CARD``: the plant of a card for another simulator, with its defaults and the card itself beside it."""

from __future__ import annotations

import json
from pathlib import Path

from sysid.actuators.card import ActuatorCard
from sysid.actuators.defaults import WRITERS
from sysid.errors import SettingsError
from sysid.export.export import SAMPLES, SEED, Export, export_plant
from sysid.export.target import Target

CARD = "card.json"


def export_card(card: ActuatorCard, target: Target, folder: Path, *, samples: int = SAMPLES, seed: int = SEED) -> Export:
    """Write a card for another simulator. It comes without recordings, so that nothing is replayed.

    Args:
        folder: new, empty, or that of an earlier export, which is replaced.
        samples, seed: draws of the parameters.

    Raises:
        SettingsError: the folder contains something else, or the target cannot represent the actuators.
    """

    def beside(half: Path) -> tuple[str, ...]:
        (half / CARD).write_text(json.dumps(card.to_json(), indent=1, ensure_ascii=False) + "\n", "utf-8")
        written = WRITERS[target.name](card, half) if target.name in WRITERS else ()
        return *written, CARD

    ratios = [f"{item.what} {item.ratio:.2f} ({item.signal})" for item in card.replays if item.ratio is not None]
    measured = f" Measured when it was made, error over that of its plant: {', '.join(ratios)}." if ratios else ""
    why = f"Not replayed: a card comes without recordings.{measured}"
    return export_plant(card.model, None, target, folder, samples=samples, seed=seed, beside=beside, unreplayed=why)


def refuse_dataset(dataset: object) -> None:
    """A card has no recordings of its own, and is not replayed on those of another machine.

    Raises:
        SettingsError: a dataset is given.
    """
    if dataset is not None:
        raise SettingsError("sysid export", f"--dataset {dataset} with a card", "a card alone", "Leave it out.")
