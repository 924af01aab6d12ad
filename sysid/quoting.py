"""Text from files inside generated text: strings, keys and comments of TOML; words and code of Markdown.

No text of a file is put into generated source code: names travel as data beside it (JSON).
"""

from __future__ import annotations

import json
import re

from sysid.files import plain
from sysid.foreign import visible

_BARE = re.compile(r"[A-Za-z0-9_-]+")
#: What Markdown, or the HTML in it, takes for its own within a line; an underscore between letters is none of it.
_MARKS = re.compile(r"[\\`*\[\]<>|~&$]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9])")


def toml_value(value: object) -> str:
    """A string, number or list of them in TOML, whose basic strings are those of JSON but for DEL.

    What is no Unicode text (an undecodable byte of a file name) becomes ``�``, since TOML cannot express it.

    Raises:
        ValueError: NaN or infinity.
    """
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, default=plain).replace("\x7f", "\\u007f")
    return re.sub("[\ud800-\udfff]", "\ufffd", text)


def toml_key(name: str) -> str:
    """A key of TOML: bare where that is possible, else quoted."""
    return name if _BARE.fullmatch(name) else toml_value(name)


def comment(text: str) -> str:
    """Text within one line of a comment: control and format characters, line ends too, are escaped."""
    return visible(text)


def markdown(text: str) -> str:
    """Text within a line or a cell of Markdown, which takes none of it for its own signs, and no HTML."""
    return _MARKS.sub(r"\\\g<0>", visible(text))


def code(text: str) -> str:
    """A code span of Markdown: between more backticks than the text has in a row."""
    shown = visible(text)
    ticks = "`" * (1 + max(map(len, re.findall("`+", shown)), default=0))
    blank = " " if shown.startswith("`") or shown.endswith("`") or not shown.strip() else ""
    return f"{ticks}{blank}{shown}{blank}{ticks}"
