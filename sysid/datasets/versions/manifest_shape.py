"""Validation of a manifest before it is used: keys, types, and names that become paths.

The seal only detects accidental changes: a hostile workspace can have a valid seal.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NotRequired

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from sysid.foreign import shown
from sysid.names import check_dataset_name, check_file_name

_Count = Annotated[int, Field(ge=0)]
_Texts = dict[str, str]
_Roles = dict[str, Literal["fit", "select", "held_out"]]


class _Origin(TypedDict):
    digest: str
    splits: _Roles


class _Base(TypedDict):
    version: Annotated[int, Field(ge=1)]
    digest: str
    by: Literal["append", "split", "update"]
    origin: NotRequired[_Origin]


class _File(TypedDict):
    path: str
    size: _Count
    sha256: str


class _Clock(TypedDict):
    recording: str
    source: str
    domain: str


class _Table(TypedDict):
    files: list[_File]
    clocks: NotRequired[list[_Clock]]


class _Made(TypedDict):
    created: str
    sysid: str
    python: str
    software: _Texts
    ingest: int
    recipe: str
    settings: dict[str, Any]
    mounts: dict[str, dict[str, Any]]


class _Part(TypedDict):
    folder: str
    samples: _Table | None
    channels: _Table | None
    made: _Made
    superseded: NotRequired[list[str]]


class _Recording(TypedDict):
    name: str
    kind: Literal["motion", "poses"]
    rate_hz: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    start_ns: Annotated[int, Field(ge=-(2**63), lt=2**63)]
    rows: _Count
    signals: list[str]
    part: _Count
    key: str | int


class _Source(TypedDict):
    path: str
    sha256: str
    size: _Count
    losses: list[str]


class _Manifest(TypedDict):
    __pydantic_config__ = ConfigDict(strict=True, extra="ignore")  # type: ignore[misc]

    schema: int
    name: str
    version: Annotated[int, Field(ge=1)]
    digest: str
    created: str
    sysid: str
    base: _Base | None
    machine_name: str
    machine: _Texts
    parts: list[_Part]
    recordings: list[_Recording]
    units: _Texts
    splits: _Roles
    sources: list[_Source]
    streams: dict[str, list[str]]
    clocks: list[dict[str, Any]]
    quality: dict[str, Any]
    beginnings: NotRequired[dict[str, list[list[str]]]]


_SHAPE = TypeAdapter(_Manifest)


def check_shape(manifest: Mapping[str, Any]) -> None:
    """Validate a manifest of the newest schema.

    Raises:
        ValueError: a key that is missing or of another type, a version that is based on itself or a later one, a missing part,
            a folder of another dataset.
        SettingsError: a name that could be a path.
    """
    try:
        _SHAPE.validate_python(manifest)
    except ValidationError as error:
        problem = error.errors()[0]
        raise ValueError(f"{'.'.join(map(str, problem['loc']))}: {problem['msg'][0].lower()}{problem['msg'][1:]}") from None
    name = check_dataset_name(manifest["name"], "name")
    base = manifest["base"]
    if base is not None and base["version"] >= manifest["version"]:
        raise ValueError(f"version {manifest['version']} is based on version {base['version']}, which is no earlier one")
    for part in manifest["parts"]:
        parent, _, last = part["folder"].rpartition("/")
        if parent != f"datasets/{name}/data" or last in ("", ".", ".."):
            raise ValueError(f"names the folder {shown(part['folder'])}, which is not of this dataset")
        for table in (part["samples"], part["channels"]):
            for file in table["files"] if table is not None else ():
                check_file_name(file["path"], "parts: file")
    names = Counter(recording["name"] for recording in manifest["recordings"])
    for recording in manifest["recordings"]:
        check_file_name(recording["name"], "recording")
        if names[recording["name"]] > 1:
            raise ValueError(f"two recordings are named {shown(recording['name'])}")
        if recording["part"] >= len(manifest["parts"]):
            found = f"part {recording['part']} of {len(manifest['parts'])}"
            raise ValueError(f"recording {shown(recording['name'])} lies in {found}")
        for signal in recording["signals"]:
            if signal not in manifest["units"]:
                raise ValueError(f"signal {shown(signal)} has no unit")
    for file in manifest["machine"]:
        _check_relative(file)


def _check_relative(path: str) -> None:
    """Validate the path of a file beside ``machine.toml``, which may be in a sub-folder."""
    if not path.isprintable() or path.startswith("/") or ".." in path.split("/"):
        raise ValueError(f"machine: file {shown(path)} is no path inside its folder")
