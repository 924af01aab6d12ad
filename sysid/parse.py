"""TOML and JSON from files with bounded depth, integers and text; anything beyond the bounds is a ValueError.

The parsers of the standard library raise RecursionError only at some depths, and accept integers that no float holds and
unpaired surrogates that cannot be written again.
"""

from __future__ import annotations

import json
import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any

#: Nested tables and lists; the project's own files have at most 12 levels.
MAX_DEPTH = 64
#: Bytes of a settings file or a description; the largest URDF of the ROS drivers has 100 kB.
MAX_BYTES = 8 * 2**20
_LARGEST = 2**63

#: Encodings of XML files that are read, and the place where one is declared.
_ENCODINGS = ("utf-8-sig", "us-ascii", "ascii", "utf-16", "iso-8859-1", "latin-1", "windows-1252")
_DECLARED = re.compile(rb"\s*<\?xml[^>]{0,200}?encoding\s*=\s*[\"']([A-Za-z0-9._-]{1,40})[\"']")
_DECLARATION = re.compile(r"\s*<\?xml[^>]*\?>")
#: A word, a quoted text or a single sign of TOML.
_TOKEN = re.compile(r"[\w-]+|\"[^\"\n]*\"|'[^'\n]*'|\S")


def parse_json(content: str | bytes) -> Any:
    """The value of a JSON text.

    Raises:
        ValueError: not JSON, or beyond the bounds.
    """
    try:
        return _bounded(json.loads(content))
    except RecursionError:
        raise _too_deep() from None


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises:
        ValueError: not TOML, beyond the bounds, or a null character, which no name and no path of the system can have.
    """
    if _longest_key(text) > MAX_DEPTH:
        raise _too_deep()
    try:
        values: dict[str, Any] = _bounded(tomllib.loads(text), null=False)
    except RecursionError:
        raise _too_deep() from None
    return values


def _longest_key(text: str) -> int:
    """Number of parts of the longest dotted key (in comments too): tomllib's time and memory grow with its square."""
    longest = parts = 0
    before = ""
    for match in _TOKEN.finditer(text):
        token = match[0]
        if token != ".":
            parts = parts + 1 if before == "." else 1
            longest = max(longest, parts)
        before = token
    return longest


def read_text(path: Path) -> str:
    """A text file in UTF-8.

    Raises:
        ValueError: not UTF-8, larger than :data:`MAX_BYTES`, or no regular file (a device, a pipe).
        OSError: missing, or not readable.
    """
    try:
        return _content(path).decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"not UTF-8 text ({error.reason})") from None


def read_xml(path: Path) -> str:
    """An XML file in the encoding that it declares, or UTF-8, without its declaration.

    Raises:
        ValueError: another encoding, or as of :func:`read_text`.
        OSError: missing, or not readable.
    """
    content = _content(path)
    stated = "utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    if (declared := _DECLARED.match(content)) is not None:
        stated = declared[1].decode("ascii").lower()
        stated = "utf-8-sig" if stated == "utf-8" else stated
    if stated not in _ENCODINGS:
        raise ValueError(f"encoding {stated[:40]!r}, where UTF-8, UTF-16 and ISO 8859-1 are read")
    try:
        text = content.decode(stated)
    except UnicodeDecodeError as error:
        raise ValueError(
            f"not text in {stated.removesuffix('-sig')} ({error.reason}), and no other encoding is declared"
        ) from None
    return _DECLARATION.sub("", text, count=1)


def _content(path: Path) -> bytes:
    # O_NONBLOCK: do not wait for the writer of a pipe.
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
        state = os.fstat(file.fileno())
        if stat.S_ISDIR(state.st_mode):
            raise IsADirectoryError(21, "is a folder", str(path))
        if not stat.S_ISREG(state.st_mode):
            raise ValueError("no regular file")
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise ValueError(f"more than {MAX_BYTES} bytes")
    return content


def _bounded(value: Any, null: bool = True) -> Any:
    """``value`` if everything in it is within the bounds; traversed without recursion.

    Args:
        null: whether texts may have a null character.
    """
    level = [value]
    for _ in range(MAX_DEPTH + 1):
        below: list[Any] = []
        for item in level:
            kind = type(item)
            if kind is str:
                if not item.isascii():
                    item.encode("utf-8")  # raises UnicodeEncodeError, a ValueError, at half a surrogate pair
                if not null and "\0" in item:
                    raise ValueError(f"a null character in {item[:40]!r}")
            elif kind is dict:
                below += item
                below += item.values()
            elif kind is list:
                below += item
            elif kind is int and not -_LARGEST <= item < 2 * _LARGEST:
                raise ValueError(f"an integer of {item.bit_length()} bits, where 64 are the most")
        if not below:
            return value
        level = below
    raise _too_deep()


def _too_deep() -> ValueError:
    return ValueError(f"nested deeper than {MAX_DEPTH} levels")
