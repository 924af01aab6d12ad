"""One thing in a workspace that has a page: a dataset version, a gap result, a model version, or a run of a machine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal
from urllib.parse import quote

from sysid.figures import ParameterFigure

Kind = Literal["logs", "dataset", "actuator", "history", "motion", "forward", "plant", "policy", "gap", "flight", "damaged"]

#: Kind → folder of its pages, and its word on the pages.
FOLDERS: dict[str, str] = {"dataset": "datasets", "gap": "reports", "flight": "flights"}
WORDS: dict[str, str] = {
    "logs": "raw files",
    "dataset": "dataset",
    "gap": "gap result",
    "actuator": "actuator networks",
    "history": "actuator networks with history",
    "motion": "motion networks",
    "forward": "forward model",
    "plant": "plant",
    "policy": "policy",
    "flight": "run",
    "damaged": "cannot be read",
}


@dataclass(frozen=True)
class Fact:
    """One property of an item, for the search and the comparison: ``Fact("Held-out RMSE", "boom joint", "0.0402°")``."""

    group: str
    name: str
    text: str


@dataclass(frozen=True)
class HeldOutError:
    """Held-out error of a model version, for the comparison.

    Args:
        reference: of the version.
        where: the recordings that it is of; errors of others are not compared with it.
        value, noise_floor: RMSE [unit]; None where the floor is not known.
    """

    reference: str
    where: str
    name: str
    unit: str
    value: float
    noise_floor: float | None = None


@dataclass(frozen=True)
class Item:
    """One thing in a workspace.

    Args:
        kind: a dataset and a plant may have the same name, so that ``reference`` alone is ambiguous.
        reference: ``name@version``; of a gap result that of its dataset version; of a run the folder of its flight log.
        created: UTC, ``2026-11-25 16:11``; empty if unknown.
        digest: content address, hexadecimal; of a gap result sha256 of its ``result.json``, of a run of its
            flight log.
        summary: its main result in one line.
        aliases: names that refer to a model version (``champion``).
        parents: :attr:`key` of the items that it was made from.
        facts: its properties, groups together.
        errors: held-out errors of it; of a gap result those of both plants.
        parameters: effect and parameter in words → its figure.
        created_plant: reference of the plant that a gap result added; empty without one.
        damage: why it cannot be read; it has no page then.
    """

    kind: Kind
    reference: str
    created: str = ""
    digest: str = ""
    summary: str = ""
    aliases: tuple[str, ...] = ()
    parents: tuple[str, ...] = ()
    facts: tuple[Fact, ...] = ()
    errors: tuple[HeldOutError, ...] = ()
    parameters: tuple[tuple[str, ParameterFigure], ...] = ()
    created_plant: str = ""
    damage: str = ""

    @property
    def key(self) -> str:
        """Identifies the item in a workspace: ``plant:autolog@1``."""
        return f"{self.kind}:{self.reference}"

    @property
    def word(self) -> str:
        return WORDS[self.kind]

    @property
    def name(self) -> str:
        """The reference without its version."""
        return self.reference.rpartition("@")[0] or self.reference

    @property
    def path(self) -> str:
        """Its page in the site; empty if it has none. Raw files are listed on the page of their dataset version."""
        if self.damage:
            return ""
        if self.kind == "logs":
            return f"datasets/{self.reference}.html"
        return f"{FOLDERS.get(self.kind, 'models')}/{self.reference}.html"

    @property
    def href(self) -> str:
        """:attr:`path` as part of a URL."""
        return quote(self.path) + ("#files" if self.kind == "logs" else "")
