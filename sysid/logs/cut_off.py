"""Detection of files that are cut between two records, by the length that the head or other parts of the file state."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path

#: Of a BLF file: signature, header size, application and its version, version of the library, size of the file.
_BLF_HEAD = struct.Struct("<4sL8xQ")


def cut_blf(path: Path) -> tuple[str, ...]:
    """A note where a BLF file is shorter than its head states; a recorder that was killed leaves no length there."""
    with path.open("rb") as file:
        head = file.read(_BLF_HEAD.size)
    if len(head) < _BLF_HEAD.size:
        return ()
    _, _, stated = _BLF_HEAD.unpack(head)
    found = path.stat().st_size
    return (f"{path.name}: the file is cut off: {found} of {stated} bytes are there",) if found < stated else ()


def missing_frames(path: Path, stated: str, found: int) -> tuple[str, ...]:
    """A note where there are fewer frames than the head states.

    Args:
        stated: text of the head; empty or no number where it states nothing.
    """
    text = stated.strip()
    if not (text.isascii() and text.isdigit() and len(text) < 16) or int(text) <= found:
        return ()
    return (f"{path.name}: the file is cut off: {found} of {int(text)} frames are there",)


def uneven_sections(path: Path, last_frames: Iterable[tuple[str, float]]) -> tuple[str, ...]:
    """A note where one part of a trial ends before another.

    Args:
        last_frames: name of each part and the number of its last frame.
    """
    ends = list(last_frames)
    latest = max((frame for _, frame in ends), default=0.0)
    return tuple(
        f"{path.name}: the file is cut off: {name} ends at frame {frame:.0f}, other sections at {latest:.0f}"
        for name, frame in ends
        if frame < latest
    )
