"""``registered.json`` beside the files of a version, from which a lost registry is rebuilt.

It lists the names and numbers under which the content was registered, with time and figures. Aliases and decisions are stored
only in the registry.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated

from pydantic import AfterValidator, Field, TypeAdapter

from sysid.errors import SysidError
from sysid.names import check_name
from sysid.parse import parse_json
from sysid.registry.stored import LATEST_MS, METRICS, StoredVersion
from sysid.root import Root

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
