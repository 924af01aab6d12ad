"""Names: checks of those that become part of a path, a key or a query; slugs; lists of names in a sentence.

A name is checked where it is read (manifest, registry row, recipe, command line), because files may come from others.
"""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Container, Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

from sysid.errors import SettingsError
from sysid.foreign import shown

#: Largest length of a name of a model, a policy, or a file of a model.
MAX_MODEL = 128
_NAME = re.compile(rf"[A-Za-z0-9][A-Za-z0-9._-]{{0,{MAX_MODEL - 1}}}")
#: Largest length of a name [bytes]: below the file system's 255, because a version number and a suffix are added.
MAX_BYTES = 200


#: Letters that Unicode does not decompose into a Latin one, or whose custom is another one than to drop the accent.
_LETTERS = str.maketrans(
    {"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "æ": "ae", "ø": "oe", "å": "aa", "œ": "oe", "ł": "l", "đ": "d", "ð": "d",
     "þ": "th", "ı": "i"}
)  # fmt: skip


def slug(text: str, otherwise: str) -> str:
    """A name of lower-case letters, digits, ``-`` and ``_`` for any text: ``Kran Größe 1`` → ``kran-groesse-1``.

    Args:
        otherwise: the name where the text holds no Latin letter and no digit.
    """
    composed = unicodedata.normalize("NFC", text).lower().translate(_LETTERS)
    plain = "".join(letter for letter in unicodedata.normalize("NFKD", composed) if not unicodedata.combining(letter))
    return re.sub(r"[^a-z0-9_-]+", "-", plain.lower()).strip("-_")[:MAX_BYTES].strip("-_") or otherwise


def listed(names: Sequence[str], most: int | None = None) -> str:
    """``a``, ``a and b``, ``a, b and c``; beyond ``most`` the others are counted."""
    if most is not None and len(names) > most:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def dotted(values: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """The values of nested tables under dotted names: ``{"a": {"b": 1}}`` gives ``("a.b", 1)``."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from dotted(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def check_name(name: Any, role: str = "model name") -> str:
    """``name`` if it can be stored and cannot be mistaken for a path or a version.

    Raises:
        SettingsError: another name; the message states the rules.
    """
    if not isinstance(name, str) or not is_name(name):
        raise SettingsError(
            role, shown(name), f"letters, digits, '.', '_' and '-', a letter or digit first, at most {MAX_MODEL}"
        )
    return name


def is_name(name: str) -> bool:
    """Whether :func:`check_name` takes it."""
    return _NAME.fullmatch(name) is not None and ".." not in name


def model_name(named: str, ending: str = "") -> str:
    """The name of a model of a machine or a dataset ``named`` so: that name where a model can have it, else its slug.

    Without a Latin letter it is ``model-`` and the begin of its sha256, so that different names have different models.
    """
    if is_name(f"{named}{ending}"):
        return f"{named}{ending}"
    digest = hashlib.sha256(named.encode("utf-8", "surrogatepass")).hexdigest()
    return f"{slug(named, f'model-{digest[:8]}')[: MAX_MODEL - len(ending)]}{ending}"


def check_dataset_name(name: Any, role: str = "dataset name", remedy: str = "") -> str:
    """As :func:`check_name`, but with letters of every alphabet.

    Raises:
        SettingsError: another name; the message states the rules.
    """
    if not isinstance(name, str) or not is_dataset_name(name):
        expected = f"letters, digits, '-', '_' and '.', at most {MAX_BYTES} bytes"
        nearby = slug(name, "") if isinstance(name, str) else ""
        raise SettingsError(role, shown(name), expected, remedy or (f"Such as {nearby}." if nearby else ""))
    return name


def is_dataset_name(name: str) -> bool:
    """Whether :func:`check_dataset_name` takes it."""
    good = bool(name) and not name.startswith(".") and all(letter.isalnum() or letter in "-_." for letter in name)
    return good and len(name.encode("utf-8", "replace")) <= MAX_BYTES


def check_pattern(pattern: str, role: str) -> str:
    """``pattern`` if it can be the glob of files inside a folder.

    Raises:
        SettingsError: empty, absolute, too long, with ``..``, or with more than one ``**`` or one that is not a whole folder.
    """
    path = PurePosixPath(pattern)
    if path.is_absolute() or ".." in path.parts:
        raise SettingsError(role, f"path {shown(pattern)} leaves the folder of the logs", "a path inside that folder")
    deep, too_long = path.parts.count("**"), any(len(part) > MAX_BYTES for part in path.parts)
    if not path.parts or too_long or pattern.count("**") > deep or deep > 1:
        raise SettingsError(role, shown(pattern), "a glob of file names, such as '*.csv'")
    return pattern


def check_file_name(name: Any, role: str) -> str:
    """``name`` if it can be the name of one file (recording, stream, file beside ``machine.toml``).

    Raises:
        SettingsError: empty, ``.``, ``..``, with ``/``, ``\\``, control characters, or too long.
    """
    good = isinstance(name, str) and name.isprintable() and not set(name) & {"/", "\\"}
    if not good or name in ("", ".", "..") or len(name.encode("utf-8", "replace")) > MAX_BYTES:
        expected = f"the name of one file: no '/', '\\' or control character, at most {MAX_BYTES} bytes"
        raise SettingsError(role, shown(name), expected)
    return str(name)


def uncut_name(name: str, names: Container[str] = ()) -> str:
    """The name of a recording before it was cut: ``run`` of the block ``run#2``; ``names``: of recordings that are no block."""
    whole, _, number = name.rpartition("#")
    return whole if whole and number.isdecimal() and name not in names else name
