"""The rows of a version beside its files: a registry that is lost is made again from them.

``registered.json`` lists under which names and numbers the content was registered, when, and with which figures. Aliases and
decisions are in the registry alone.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from sysid.registry.stored import METRICS, StoredVersion

RECORDS = "registered.json"


@dataclass(frozen=True)
class Record:
    """One row: name, number, when it was registered [ms since 1970], figures as the JSON that the registry holds."""

    name: str
    version: int
    created_ms: int
    metrics: str

    @staticmethod
    def of(name: str, version: StoredVersion) -> Record:
        return Record(name, version.number, version.created_ms, version.tags.get(METRICS, "{}"))


def read_records(folder: Path) -> tuple[Record, ...]:
    """The rows beside the files in ``folder``; none where they are missing or damaged."""
    try:
        values = json.loads((folder / RECORDS).read_text("utf-8"))["registered"]
        return tuple(
            Record(str(item["name"]), int(item["version"]), int(item["created_ms"]), str(item["metrics"])) for item in values
        )
    except (OSError, ValueError, KeyError, TypeError):
        return ()


def with_record(records: Sequence[Record], record: Record) -> bytes:
    """The file that holds ``records`` and ``record``, which takes the place of the one with its name."""
    others = [other for other in records if other.name != record.name]
    rows = [asdict(row) for row in sorted([*others, record], key=lambda row: row.name)]
    return (json.dumps({"schema": 1, "registered": rows}, indent=2) + "\n").encode("utf-8")
