"""Lines of the list of versions, and those of earlier lists.

A manifest is written once: as long as its file is the same, by device, inode, size and times, so is its line. Lines are kept in
the user's cache folder, because proving a manifest by its seal takes longer than everything else in a list.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import astuple, dataclass, field, fields
from typing import Any

from sysid.errors import StorageError
from sysid.files import make_folder, written_whole
from sysid.location import cache_home
from sysid.parse import parse_json, read_text

#: A file that changed within this time [ns] may change again with the same times, which count in ticks of the system.
TICK_NS = 2_000_000_000
Identity = tuple[int, ...]


@dataclass(frozen=True)
class Entry:
    """One line of the list of versions; ``damage``: why a version cannot be read, then the other fields are empty."""

    name: str
    version: int
    digest: str = ""
    created: str = ""
    machine: str = ""
    recordings: int = 0
    seconds: float = 0.0
    damage: str = ""

    @property
    def reference(self) -> str:
        return f"{self.name}@{self.version}"


@dataclass
class KeptEntries:
    """The lines of an earlier list, and those of this one.

    Args:
        earlier: reference → the identity of its manifest, and the line.
    """

    earlier: Mapping[str, tuple[Identity, Entry]]
    now: dict[str, tuple[Identity, Entry]] = field(default_factory=dict)

    def entry(self, found: Entry, identity: Identity | None, read: Callable[[], Entry]) -> Entry:
        """The line of a manifest of this ``identity``; it is ``read`` where it is not kept."""
        known, kept = self.earlier.get(found.reference, (None, found))
        entry = kept if identity is not None and identity == known else read()
        if identity is not None and not entry.damage and max(identity[-2:]) < time.time_ns() - TICK_NS:
            self.now[entry.reference] = identity, entry
        return entry


@contextmanager
def kept_entries(place: str) -> Iterator[KeptEntries]:
    """The kept lines of the datasets at ``place``; at the end of the block those of this list are kept."""
    path = cache_home() / "versions" / f"{hashlib.sha256(place.encode('utf-8', 'surrogateescape')).hexdigest()[:32]}.json"
    kept = KeptEntries({})
    with suppress(OSError, ValueError, TypeError):  # missing, damaged, or of another sysid: everything is read
        kept = KeptEntries({entry.reference: (identity, entry) for identity, entry in map(_line, parse_json(read_text(path)))})
    yield kept
    if kept.now != kept.earlier:
        with suppress(OSError, StorageError):  # a list needs no cache
            make_folder(path.parent)
            with written_whole(path) as half:
                half.write_text(json.dumps([(identity, astuple(entry)) for identity, entry in kept.now.values()]))


def _line(item: Any) -> tuple[Identity, Entry]:
    identity, values = item
    kinds = [type(getattr(Entry("", 0), entry.name)) for entry in fields(Entry)]
    if [type(value) for value in values] != kinds or {type(number) for number in identity} != {int}:
        raise ValueError("no line of a list")
    return tuple(identity), Entry(*values)
