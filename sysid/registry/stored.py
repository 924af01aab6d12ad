"""Unchecked rows of a model in a registry (numbers, tags, aliases), changes of them, and ``registered.json`` beside its files,
from which a lost registry is rebuilt: it has names and numbers with time and figures, neither aliases nor decisions.

Both registries (:mod:`sysid.registry.tables`, :mod:`sysid.registry.server`) use these values.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Annotated

from pydantic import AfterValidator, Field, TypeAdapter

from sysid.errors import SysidError
from sysid.names import check_name
from sysid.parse import parse_json
from sysid.root import Root

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


#: A change as plain values, and back.
CHANGE = TypeAdapter(ModelChange)
#: Current state of a model, under the lock → its change; None: no change.
ChangeBuilder = Callable[[StoredModel], ModelChange | None]


RECORDS = "registered.json"


@dataclass(frozen=True)
class Record:
    """One row: name, number, time of registration [ms since 1970], figures as JSON text."""

    name: Annotated[str, AfterValidator(check_name)]
    version: Annotated[int, Field(gt=0)]
    created_ms: Annotated[int, Field(ge=0, le=LATEST_MS)]
    metrics: str

    @staticmethod
    def of(name: str, version: StoredVersion) -> Record:
        return Record(name, version.number, version.created_ms, version.tags.get(METRICS, "{}"))


_RECORDS = TypeAdapter(tuple[Record, ...])


def read_records(root: Root, folder: str) -> tuple[Record, ...]:
    """The rows beside the files in ``folder``; empty if they are missing, damaged, or reached by a link."""
    try:
        values = parse_json(root.read(f"{folder}/{RECORDS}"))
        return _RECORDS.validate_python(values["registered"])
    except (OSError, ValueError, KeyError, TypeError, SysidError):
        return ()


def with_record(records: Sequence[Record], record: Record) -> bytes:
    """The file content for ``records`` with ``record``, which replaces the one of the same name."""
    others = [other for other in records if other.name != record.name]
    rows = [asdict(row) for row in sorted([*others, record], key=lambda row: row.name)]
    return (json.dumps({"schema": 1, "registered": rows}, indent=2) + "\n").encode("utf-8")
