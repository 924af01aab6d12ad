"""Settings: frozen dataclasses filled from TOML; an unknown key, a wrong type or a missing file is an error that says where."""

from __future__ import annotations

import dataclasses
import functools
import re
import tomllib
import types
import typing
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import ConfigDict, TypeAdapter, ValidationError

from sysid.errors import SettingsError, nearest

T = TypeVar("T")

#: Put ``__pydantic_config__ = STRICT`` into a settings dataclass: unknown keys fail.
STRICT = ConfigDict(extra="forbid", strict=False, arbitrary_types_allowed=True)


#: Settings are written by hand. The parser keeps every beginning of a dotted key: a long one takes memory by its square.
_MAX_TOML, _MAX_PARTS = 2**20, 32
#: Words, texts and single signs: what a line of TOML is made of.
_TOKEN = re.compile(r"[\w-]+|\"[^\"\n]*\"|'[^'\n]*'|\S")


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file into a dictionary.

    Raises:
        SettingsError: the file is missing, no file, too large, nested too deep, is not UTF-8 or is not TOML.
    """
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for
            raise SettingsError(path, "is a folder" if path.is_dir() else "is no file", "a TOML file")
        if path.exists() and path.stat().st_size > _MAX_TOML:
            found = f"{path.stat().st_size / 2**20:.1f} MiB"
            raise SettingsError(path, found, f"a TOML file of at most {_MAX_TOML // 2**20} MiB", "Is it the right file?")
        text = path.read_text("utf-8")
        if _longest_key(text) > _MAX_PARTS:
            raise SettingsError(path, f"a key of more than {_MAX_PARTS} parts", "the keys of the documentation")
        return tomllib.loads(text)
    except RecursionError:
        raise SettingsError(path, "values nested too deep", "a TOML file as a person writes it") from None
    except FileNotFoundError:
        raise SettingsError(path, "no such file", "a TOML file", "Check the path.") from None
    except UnicodeDecodeError as error:
        raise SettingsError(path, f"not UTF-8 text ({error.reason})", "a TOML file") from None
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(path, f"not valid TOML: {error}") from None


def _longest_key(text: str) -> int:
    """Parts of the longest dotted key in TOML; a text with as many words between dots counts, too."""
    longest = parts = 0
    before = ""
    for match in _TOKEN.finditer(text):
        token = match[0]
        if token != ".":
            parts = parts + 1 if before == "." else 1
            longest = max(longest, parts)
        before = token
    return longest


def load_settings(path: Path, cls: type[T]) -> T:
    """Read ``path`` (TOML) into the frozen dataclass ``cls``."""
    return parse_settings(read_toml(path), cls, where=path)


def parse_settings(values: dict[str, Any], cls: type[T], where: object) -> T:
    """Fill the frozen dataclass ``cls`` from ``values``; ``where`` names their source in messages.

    Raises:
        SettingsError: an unknown or missing key, or a value of the wrong type.
    """
    try:
        # The checker does not take a class for hashable, which every class is.
        result: T = _adapter(typing.cast(Any, cls)).validate_python(values)
        return result
    except ValidationError as error:
        raise _as_settings_error(error, cls, where) from None


@functools.cache
def _adapter(cls: Any) -> TypeAdapter[Any]:
    return TypeAdapter(cls)


def _as_settings_error(error: ValidationError, cls: type[Any], where: object) -> SettingsError:
    problem = error.errors()[0]
    path = problem["loc"]
    key = _dotted(path)
    if problem["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        valid = _keys_at(cls, path[:-1])
        return SettingsError(where, f"unknown key {key!r}", nearest(str(path[-1]), valid), "Correct or remove the key.")
    if problem["type"] in ("missing", "missing_argument"):
        return SettingsError(where, f"key {key!r} is missing", "it to be given")
    return SettingsError(where, f"{key} = {problem['input']!r}", problem["msg"][0].lower() + problem["msg"][1:])


def _dotted(path: tuple[int | str, ...]) -> str:
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _keys_at(cls: Any, path: tuple[int | str, ...]) -> list[str]:
    """The field names of the dataclass that ``path`` leads to inside ``cls``; empty where it is no dataclass."""
    for part in path:
        if typing.get_origin(cls) is dict:
            cls = get_args(cls)[1]
        elif isinstance(part, str) and dataclasses.is_dataclass(cls):
            cls = typing.get_type_hints(cls).get(part)
        # The keys of a dictionary are a step of the path of their own.
        if typing.get_origin(cls) is not dict:
            cls = _dataclass_inside(cls)
    return [field.name for field in dataclasses.fields(cls) if field.init] if dataclasses.is_dataclass(cls) else []


def _dataclass_inside(annotation: Any) -> Any:
    """The dataclass in ``tuple[X, ...]``, ``X | None`` or ``dict[str, X]``, else the annotation itself."""
    if dataclasses.is_dataclass(annotation):
        return annotation
    for argument in get_args(annotation):
        if argument is types.NoneType:
            continue
        inner = _dataclass_inside(argument)
        if dataclasses.is_dataclass(inner):
            return inner
    return annotation


def inside(root: Path, relative: str, where: object) -> Path:
    """The path ``relative`` below ``root``.

    Raises:
        SettingsError: the path leaves ``root`` (``..``, an absolute path or a link out of it).
    """
    path = (root / relative).resolve()
    if not path.is_relative_to(root.resolve()):
        remedy = "Copy it there: links out of the folder are not followed." if Path(relative).is_absolute() else ""
        raise SettingsError(where, f"path {relative!r} leaves the folder {root}", "a path inside that folder", remedy)
    return path
