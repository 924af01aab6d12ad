"""A model as a registry stores it, before anything of it is read: numbers, tags, aliases; and one change of it.

Both kinds of registry (:mod:`sysid.registry.tables`, :mod:`sysid.registry.server`) give and take these values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

#: Tags of an MLflow version. One tag a decision: nothing that was decided is ever rewritten.
DIGEST, MANIFEST, METRICS, DECISION = "sysid.digest", "sysid.manifest", "sysid.metrics", "sysid.decision"
#: Tag of a version, and of a model: a digest over what the manifest does not cover.
SEAL = "sysid.seal"
#: The last millisecond that has a date, since 1970.
LATEST_MS = 253_402_300_799_999


@dataclass(frozen=True)
class StoredVersion:
    """One version: its number, when it was made [ms since 1970], where its files lie, its tags."""

    number: int
    created_ms: int
    source: str
    tags: Mapping[str, str]

    @property
    def own(self) -> bool:
        """Whether this toolkit registered it, not another program."""
        return DIGEST in self.tags and MANIFEST in self.tags


@dataclass(frozen=True)
class StoredModel:
    """All versions of one name, oldest first, with the aliases and tags of the name.

    Args:
        last: the highest number that was ever given; numbers are never given twice.
    """

    name: str
    versions: tuple[StoredVersion, ...] = ()
    aliases: Mapping[str, int] = field(default_factory=dict)
    tags: Mapping[str, str] = field(default_factory=dict)
    last: int = 0

    @property
    def own(self) -> tuple[StoredVersion, ...]:
        return tuple(version for version in self.versions if version.own)


@dataclass(frozen=True)
class ModelChange:
    """What one registration, decision or alias changes in a model: all of it is done, or nothing.

    Args:
        new: a version to be added.
        run: MLflow run that holds its files, on a server.
        version_tags: number → tags to be set; None removes one.
        aliases: alias → number that it means from now on; None removes it.
        tags: of the model, to be set.
    """

    new: StoredVersion | None = None
    run: str | None = None
    version_tags: Mapping[int, Mapping[str, str | None]] = field(default_factory=dict)
    aliases: Mapping[str, int | None] = field(default_factory=dict)
    tags: Mapping[str, str] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        new = self.new
        return {
            "new": None if new is None else [new.number, new.created_ms, new.source, dict(new.tags)],
            "run": self.run,
            "version_tags": {str(number): dict(tags) for number, tags in self.version_tags.items()},
            "aliases": dict(self.aliases),
            "tags": dict(self.tags),
        }

    @staticmethod
    def from_json(values: Mapping[str, Any]) -> ModelChange:
        """What :meth:`to_json` gave.

        Raises:
            KeyError, TypeError, ValueError, AttributeError: it is something else.
        """
        new = values["new"]
        return ModelChange(
            None if new is None else StoredVersion(int(new[0]), int(new[1]), str(new[2]), dict(new[3])),
            values["run"],
            {int(number): dict(tags) for number, tags in values["version_tags"].items()},
            dict(values["aliases"]),
            dict(values["tags"]),
        )


#: What is to be changed in a model as it stands when nobody else can change it; None: nothing.
Build = Callable[[StoredModel], ModelChange | None]


class Tables(Protocol):
    """Reads models, and changes one of them at a time."""

    #: Whether the aliases are this toolkit's alone, so that a change by another hand is a mistake.
    seals_aliases: bool

    def model(self, name: str) -> StoredModel:
        """One model; without versions where there is none of this name."""
        ...

    def models(self) -> tuple[StoredModel, ...]:
        """Every model, by name; nothing is made or migrated by looking."""
        ...

    def change(self, name: str, build: Build) -> StoredModel:
        """Carry out what ``build`` returns, whole or not at all; returns the model as it is then.

        Raises:
            StoreError: the registry is in use, cannot be reached, or is none.
            StorageError: the disk is full, or may not be written; nothing was changed then.
        """
        ...
