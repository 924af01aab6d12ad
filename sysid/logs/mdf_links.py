"""The links between the blocks of an MDF 4 file: a chain that leads back into itself would be followed for ever.

The header links to chains of data groups, file histories, hierarchies, attachments and events; a data group to its channel
groups and data lists, a channel group to its channels, a channel to those it is composed of. No block belongs to two chains.
Source: ASAM MDF 4.1 programmers' guide, "Block structure".
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

#: Where the header's links to the chains stand: data groups, histories, hierarchies, attachments, events.
_CHAINS = {88: "DG", 96: "FH", 104: "CH", 112: "AT", 120: "EV"}
#: Behind id, length and number of links (24 bytes) comes the next of the same kind, then what is below.
_NEXT, _BELOW, _DATA = 24, 32, 40
_CHILD = {"DG": "CG", "CG": "CN", "CN": "CN", "CH": "CH"}


def linked_twice(path: Path) -> int | None:
    """Position of a block that two links of these chains lead to; None where there is none, as it should be."""
    with path.open("rb") as file:
        waiting = [(kind, _link(file, at)) for at, kind in _CHAINS.items()]
        seen: set[tuple[str, int]] = set()
        while waiting:
            kind, at = waiting.pop()
            if not at:
                continue
            if (kind, at) in seen:
                return at
            seen.add((kind, at))
            waiting.append((kind, _link(file, at + _NEXT)))
            if kind in _CHILD and not (kind in ("CN", "CH") and _id(file, _link(file, at + _BELOW)) != f"##{kind}".encode()):
                waiting.append((_CHILD[kind], _link(file, at + _BELOW)))
            if kind == "DG":
                data = _link(file, at + _DATA)
                data = _link(file, data + _NEXT) if _id(file, data) == b"##HL" else data
                if _id(file, data) == b"##DL":
                    waiting.append(("DL", data))
    return None


def _id(file: BinaryIO, at: int) -> bytes:
    if not at:
        return b""
    file.seek(at)
    return file.read(4)


def _link(file: BinaryIO, at: int) -> int:
    """Where the link at this position leads; 0 where it does not lead into the file."""
    file.seek(at)
    cell = file.read(8)
    target = struct.unpack("<Q", cell)[0] if len(cell) == 8 else 0
    return target if target < file.seek(0, 2) else 0
