"""Text from files for a terminal: control and format characters escaped, length bounded.

A name in a log, a manifest or a registry may hold escape sequences that move the cursor, write to the clipboard, or hide the
rest of a line, or directional marks that reorder letters. They are replaced by Python's escapes (``\\x1b``, ``\\u202e``).
"""

from __future__ import annotations

import unicodedata

#: Largest number of characters of a name, and of a printed line.
MAX_NAME = 200
MAX_LINE = 20_000
#: Control, format (directional marks, zero-width), surrogate, private, unassigned; line and paragraph separators.
_HIDDEN = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})


def visible(text: object, most: int = MAX_LINE, keep: str = "") -> str:
    """``text`` with every hidden character escaped, cut after ``most`` characters.

    Args:
        keep: characters that are not escaped, such as line breaks.
    """
    words = str(text)
    left_out = len(words) - most
    if left_out > 0:
        words = words[:most]
    if not words.isascii() or not words.isprintable():
        words = "".join(letter if letter in keep or not _hidden(letter) else _escaped(letter) for letter in words)
    return f"{words}… ({left_out} characters more)" if left_out > 0 else words


def shown(value: object, most: int = MAX_NAME) -> str:
    """``repr`` of a value for messages, escaped and bounded."""
    try:
        words = repr(value[: most + 1] if isinstance(value, str | bytes | list | tuple) else value)
    except ValueError:  # an integer of more digits than Python converts
        words = f"an integer of {value.bit_length()} bits" if isinstance(value, int) else type(value).__name__
    return visible(words, most)


def is_unicode(text: str) -> bool:
    """Whether ``text`` has no unpaired surrogate, as an undecodable byte of a file name becomes one: UTF-8 can hold it."""
    return not any("\ud800" <= letter <= "\udfff" for letter in text)


def escaped_json(text: str) -> str:
    """JSON with every hidden character of its texts as ``\\uXXXX``: the same values, safe for a terminal."""
    if text.isascii():  # JSON itself escapes the control characters of ASCII, but DEL
        return text.replace("\x7f", "\\u007f")
    return "".join(letter if letter in "\n\t\r" or not _hidden(letter) else _as_utf16(letter) for letter in text)


def _as_utf16(letter: str) -> str:
    units = letter.encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[i]:02x}{units[i + 1]:02x}" for i in range(0, len(units), 2))


def _hidden(letter: str) -> bool:
    return unicodedata.category(letter) in _HIDDEN


def _escaped(letter: str) -> str:
    return letter.encode("unicode_escape", "backslashreplace").decode("ascii")
