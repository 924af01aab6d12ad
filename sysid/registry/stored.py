"""Unchecked rows of a model in a registry (numbers, tags, aliases), and changes of them.

Both registries (:mod:`sysid.registry.tables`, :mod:`sysid.registry.server`) use these values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

#: Tags of an MLflow version; each decision has its own, so that none is rewritten.
DIGEST, MANIFEST, METRICS, DECISION = "sysid.digest", "sysid.manifest", "sysid.metrics", "sysid.decision"
#: Tag of a version, and of a model: a digest of what the manifest does not cover.
SEAL = "sysid.seal"
#: Largest time stamp that is a date [ms since 1970].
LATEST_MS = 253_402_300_799_999


@dataclass(frozen=True)
class StoredVersion:
    """One version: number, time of registration [ms since 1970], location of its files, tags."""

    number: int
    created_ms: int
    source: str
    tags: Mapping[str, str]

    @property
    def own(self) -> bool:
        """Whether this toolkit registered it."""
        return DIGEST in self.tags and MANIFEST in self.tags


@dataclass(frozen=True)
class StoredModel:
    """All versions of one name, oldest first, with the aliases and tags of the name.

    Args:
        last: the highest number ever used; numbers are not reused.
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
    """An atomic change of a model: registration, decision or alias.

    Args:
        new: a version to add.
        run: MLflow run with its files, on a server.
        version_tags: number → tags to set; None removes one.
        aliases: alias → version number; None removes it.
        tags: of the model, to set.
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


#: Current state of a model, under the lock → its change; None: no change.
ChangeBuilder = Callable[[StoredModel], ModelChange | None]
