"""Settings: frozen dataclasses filled from TOML; unknown keys, wrong types and missing files are errors with their location."""

from __future__ import annotations

import dataclasses
import functools
import types
import typing
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import ConfigDict, TypeAdapter, ValidationError

from sysid.errors import SettingsError, nearest
from sysid.foreign import shown
from sysid.numbers import expected_of
from sysid.parse import parse_toml, read_text

T = TypeVar("T")

#: Configuration of :class:`Strict`: unknown keys, NaN and infinity fail.
STRICT = ConfigDict(extra="forbid", strict=False, arbitrary_types_allowed=True, allow_inf_nan=False)


#: Types of the errors of pydantic for keys that do not exist, and for keys that are missing.
_UNKNOWN, _MISSING = ("extra_forbidden", "unexpected_keyword_argument"), ("missing", "missing_argument")


class Strict:
    """Base class of settings dataclasses: unknown keys, NaN and infinity fail."""

    __pydantic_config__ = STRICT


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file into a dictionary.

    Raises:
        SettingsError: the file is missing, is not text, is not TOML, or is nested beyond the bounds of :mod:`sysid.parse`.
    """
    return toml_values(settings_text(path), path)


def settings_text(path: Path, what: str = "a TOML file") -> str:
    """The text of a file that the user named.

    Raises:
        SettingsError: the file is missing, is a folder, a device or a pipe, is not UTF-8, or is too large.
    """
    try:
        return read_text(path)
    except FileNotFoundError:
        raise SettingsError(path, "no such file", what, "Check the path.") from None
    except IsADirectoryError:
        raise SettingsError(path, "is a folder", what) from None
    except ValueError as error:
        raise SettingsError(path, str(error), what) from None


def toml_values(text: str, where: object) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises:
        SettingsError: not TOML, or nested beyond the bounds of :mod:`sysid.parse`.
    """
    try:
        return parse_toml(text)
    except ValueError as error:
        raise SettingsError(where, f"not valid TOML: {error}") from None


def load_settings(path: Path, cls: type[T]) -> T:
    """Read ``path`` (TOML) into the frozen dataclass ``cls``."""
    return parse_settings(read_toml(path), cls, where=path)


def parse_settings(values: dict[str, Any], cls: type[T], where: object) -> T:
    """Fill the frozen dataclass ``cls`` from ``values``; ``where`` names their source in messages.

    Raises:
        SettingsError: an unknown or missing key, or a value of the wrong type.
    """
    try:
        # mypy does not accept a class as hashable.
        result: T = _adapter(typing.cast(Any, cls)).validate_python(values)
        return result
    except ValidationError as error:
        raise _as_settings_error(error, cls, where) from None


@functools.cache
def _adapter(cls: Any) -> TypeAdapter[Any]:
    return TypeAdapter(cls)


def _as_settings_error(error: ValidationError, cls: type[Any], where: object) -> SettingsError:
    problems = error.errors()
    unknown = [each for each in problems if each["type"] in _UNKNOWN]
    # A misspelt key is unknown and the right one is missing: the first says why.
    problem = unknown[0] if unknown and problems[0]["type"] in _MISSING else problems[0]
    path = problem["loc"]
    key = _dotted(path)
    if problem["type"] in _UNKNOWN:
        valid = _keys_at(cls, path[:-1])
        return SettingsError(where, f"unknown key {key!r}", nearest(str(path[-1]), valid), "Correct or remove the key.")
    if problem["type"] in _MISSING:
        return SettingsError(where, f"key {key!r} is missing", "it to be given")
    return SettingsError(where, f"{key} = {shown(problem['input'])}", expected_of(problem["msg"]))


def _dotted(path: tuple[int | str, ...]) -> str:
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _keys_at(cls: Any, path: tuple[int | str, ...]) -> list[str]:
    """The field names of the dataclass at ``path`` inside ``cls``; empty if that is no dataclass."""
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
        SettingsError: the path leaves ``root`` (``..``, an absolute path or a link out of it), or is none that the system has.
    """
    try:
        path = (root / relative).resolve()
        path.exists()
    except (OSError, ValueError, RuntimeError) as error:  # the latter: links in a circle
        found = f"path {shown(relative)} ({getattr(error, 'strerror', None) or error})"
        raise SettingsError(where, found, "a path inside its folder") from None
    if not path.is_relative_to(root.resolve()):
        remedy = "Copy it there: links out of the folder are not followed." if Path(relative).is_absolute() else ""
        raise SettingsError(where, f"path {relative!r} leaves the folder {root}", "a path inside that folder", remedy)
    return path
