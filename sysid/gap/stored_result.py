"""Stores and loads gap results, for reports without a new computation."""

from __future__ import annotations

import functools
import hashlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_type_hints

import pandas as pd
from filelock import FileLock
from pydantic import TypeAdapter

from sysid.errors import SettingsError, StorageError, StoreError
from sysid.files import json_text
from sysid.gap.experiment import Experiment, read_experiment, write_experiment
from sysid.gap.result import EXPERIMENTS, GapResult, Traces
from sysid.parse import parse_json
from sysid.root import Root

RESULT, TRACES, DIFFERENCE, SEAL = "result.json", "traces.parquet", "machine.diff", "seal.json"
REMEDY = "Run `sysid gap` again."
VERSIONS = ("measured", "before", "after")
_SEALED = TypeAdapter(dict[str, str])
#: Beyond any number of a result; squares of smaller ones are finite.
_LARGEST = 1e100


def save_gap(folder: Path, result: GapResult) -> Path:
    """Store ``result`` as ``folder``, replacing an earlier one atomically.

    The files are written to a temporary folder. Its rename to ``<folder>.next`` commits the result; an interrupted replacement
    is completed by the next call.

    Raises:
        StorageError: the disk is full or read-only.
        StoreError: ``folder``, or a folder on the way, is a link.
    """
    root, name = Root(folder.parent), folder.name
    draft = f".{name}.part"
    try:
        with FileLock(root.output(f".{name}.lock")):
            _complete(root, name)
            root.remove(draft)  # of a killed process
            _write(root, draft, result)
            root.settle(draft)
            root.rename(draft, _committed(name))
            _complete(root, name)
    except OSError as error:
        found = f"cannot be written ({error.strerror or error}); a complete result, old or new, is stored"
        raise StorageError(folder, found, remedy="Free disk space and run the command again.") from None
    return folder / RESULT


def load_gap(folder: Path) -> GapResult | None:
    """The result that :func:`save_gap` stored as ``folder``; None if there is none.

    Raises:
        StoreError: a file is damaged, was changed, or is a link.
    """
    above = Root(folder.parent)
    root = Root(above.path(_committed(folder.name) if above.kind(_committed(folder.name)) == "folder" else folder.name))
    path = root.folder / RESULT
    if root.kind(RESULT) is None:
        return None
    _check_seal(root)
    try:
        values = _numbers(parse_json(root.read(RESULT)))
        experiments = tuple(read_experiment(root.path(item["file"])) for item in values.get("experiments", []))
        return _result(values, _traces(root.path(TRACES)), experiments)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, SettingsError) as error:
        message = str(error).splitlines()[0]
        raise StoreError(path, f"not readable ({message})", "a result as it was written", REMEDY) from None


def _committed(name: str) -> str:
    return f"{name}.next"


def _complete(root: Root, name: str) -> None:
    """Replace the earlier result by a committed one."""
    if root.path(_committed(name)).is_dir():
        root.remove(name)
        root.rename(_committed(name), name)


def _write(root: Root, folder: str, result: GapResult) -> None:
    """Write all files of a result, the seal last."""
    root.make(folder)
    frames = [
        getattr(trace, version).assign(recording=trace.recording, version=version)
        for trace in result.traces
        for version in VERSIONS
    ]
    if frames:
        pd.concat(frames, ignore_index=True).to_parquet(root.output(f"{folder}/{TRACES}"), index=False)
    for experiment in result.experiments:
        write_experiment(root.make(f"{folder}/{EXPERIMENTS}"), experiment)
    root.write_new(f"{folder}/{DIFFERENCE}", result.machine_diff.encode("utf-8"))
    root.write_new(f"{folder}/{RESULT}", json_text(result.to_json()).encode("utf-8"))
    digests = {name: hashlib.sha256(root.read(f"{folder}/{name}")).hexdigest() for name in _files(root, folder)}
    root.write_new(f"{folder}/{SEAL}", json_text({"schema": 1, "sha256": digests}).encode("utf-8"))


def _files(root: Root, folder: str) -> Iterator[str]:
    """The files of a result, relative to its folder."""
    for name, kind in root.entries(folder).items():
        if kind == "file":
            yield name
    for name in root.entries(f"{folder}/{EXPERIMENTS}"):
        yield f"{EXPERIMENTS}/{name}"


def _check_seal(root: Root) -> None:
    """Compare the files with the seal; results of earlier releases have none.

    Raises:
        StoreError: a file was changed.
    """
    try:
        sealed = _SEALED.validate_python(parse_json(root.read(SEAL))["sha256"])
    except FileNotFoundError:
        return
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StoreError(root.folder / SEAL, f"not readable ({error})", "the seal as it was written", REMEDY) from None
    for name, digest in sorted(sealed.items()):
        expected = f"sha256 {digest[:12]}…"
        try:
            content = root.read(name)
        except (FileNotFoundError, NotADirectoryError):
            raise StoreError(root.folder / name, "the file is missing", expected, REMEDY) from None
        if hashlib.sha256(content).hexdigest() != digest:
            raise StoreError(root.folder / name, "changed after it was written", expected, REMEDY)


def _result(values: dict[str, Any], traces: tuple[Traces, ...], experiments: tuple[Experiment, ...]) -> GapResult:
    for effect in values["effects"]:
        effect["aliases"] = [(alias["name"], alias["target"]) for alias in effect.get("aliases", [])]
        for key, left in effect.get("undetermined", {}).items():
            effect["parameters"][key], effect["interval95"][key] = left["in_plant"], left["interval95"]
        effect["undetermined"] = tuple(effect.get("undetermined", ()))
    raw = {key: values[key] for key in _types() if key in values}
    raw |= {"plant_before": values["plant"]["before"], "plant_after": values["plant"]["after"]}
    raw["ambiguous"] = [[(item["name"], item["target"]) for item in tie] for tie in values["ambiguous"]]
    raw |= {"world_gap": _world_gap(values.get("world_gap")), "promotion": _promotion(values.get("promotion"))}
    ((stream, order),) = values.get("convention", {}).items() or (("", None),)
    raw["order"] = {"stream": stream, **order} if isinstance(order, dict) else None
    checked = {key: _types()[key].validate_python(value) for key, value in raw.items()}
    return GapResult(**checked, traces=traces, experiments=experiments)


@functools.cache
def _types() -> dict[str, TypeAdapter[Any]]:
    """Field of a result → its type; without those that are in other files."""
    kinds = get_type_hints(GapResult, localns={"Experiment": Experiment})
    return {key: TypeAdapter(kind) for key, kind in kinds.items() if key not in ("traces", "experiments")}


def _world_gap(values: dict[str, Any] | float | None) -> dict[str, Any] | None:
    if not isinstance(values, dict):
        return None
    world = {key: values.pop(key) for key in ("before", "after", "noise_floor")}
    return {"world": world, **values}


def _promotion(values: dict[str, Any] | float | None) -> dict[str, Any] | None:
    return {key: value for key, value in values.items() if key != "promoted"} if isinstance(values, dict) else None


def _traces(path: Path) -> tuple[Traces, ...]:
    if not path.is_file():
        return ()
    table = pd.read_parquet(path)
    found = []
    for recording in dict.fromkeys(table["recording"]):
        tables = []
        for version in VERSIONS:
            rows = table[(table["recording"] == recording) & (table["version"] == version)]
            # The versions have different columns; those of the others are empty here.
            rows = rows.drop(columns=["recording", "version"]).dropna(axis="columns", how="all")
            tables.append(rows.reset_index(drop=True))
        measured, before, after = tables
        found.append(Traces(str(recording), measured, before, after))
    return tuple(found)


def _numbers(value: Any) -> Any:
    """``value`` with NaN in the place of null, which stands for numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _numbers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_numbers(item) for item in value]
    if isinstance(value, float | int) and abs(value) > _LARGEST:
        raise ValueError(f"a number beyond {_LARGEST:g}")
    return math.nan if value is None else value
