"""Keeps the answer of the gap workflow beside the models, so that a report can be made again without computing it again."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from pathlib import Path
from typing import Any

import pandas as pd
from filelock import FileLock
from pydantic import TypeAdapter

from sysid.errors import SettingsError, StorageError, StoreError
from sysid.files import json_text, make_folder, on_disk
from sysid.gap.experiment import Experiment, read_experiment, write_experiment
from sysid.gap.result import (
    EXPERIMENTS,
    Candidate,
    Excitation,
    Gap,
    GapResult,
    Localised,
    Map,
    NamedEffect,
    Promotion,
    ResidualModelResult,
    Share,
    Traces,
    Unnamed,
    WorldGap,
)

RESULT, TRACES, DIFFERENCE, SEAL = "result.json", "traces.parquet", "machine.diff", "seal.json"
AGAIN = "Run `sysid gap` again."
VERSIONS = ("measured", "before", "after")


def save_gap(folder: Path, result: GapResult) -> Path:
    """File ``result`` as ``folder``, in the place of the one before: all of its files or none.

    They are written to a folder beside it, which counts from its rename to ``<folder>.next`` on; what remains to be done then
    is done by the next call, if not by this one.

    Raises:
        StorageError: the disk is full, or may not be written.
    """
    draft = folder.with_name(f".{folder.name}.part")
    try:
        make_folder(folder.parent)
        with FileLock(folder.with_name(f".{folder.name}.lock")):
            _settle(folder)
            if draft.exists():  # of a dead writer
                shutil.rmtree(draft)
            draft.mkdir()
            _write(draft, result)
            draft.rename(_ready(folder))
            on_disk(folder.parent)
            _settle(folder)
    except OSError as error:
        found = f"cannot be written ({error.strerror or error}); the result before, or this one, is whole"
        raise StorageError(folder, found, remedy="Make room, and run the command again.") from None
    return folder / RESULT


def load_gap(folder: Path) -> GapResult | None:
    """The result that :func:`save_gap` filed as ``folder``; None where there is none.

    Raises:
        StoreError: the files are damaged, or were changed after they were written.
    """
    folder = _ready(folder) if _ready(folder).is_dir() else folder
    path = folder / RESULT
    if not path.is_file():
        return None
    _check_seal(folder)
    try:
        values = _numbers(json.loads(path.read_text("utf-8")))
        experiments = tuple(read_experiment(folder / item["file"]) for item in values.get("experiments", []))
        return _result(values, _traces(folder / TRACES), experiments)
    except (ValueError, KeyError, TypeError, SettingsError) as error:
        message = str(error).splitlines()[0]
        raise StoreError(path, f"not readable ({message})", "a result as it was written", AGAIN) from None


def _ready(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.next")


def _settle(folder: Path) -> None:
    """Let a result that is ready take the place of the one before."""
    if _ready(folder).is_dir():
        if folder.exists():
            shutil.rmtree(folder)
        _ready(folder).rename(folder)
        on_disk(folder.parent)


def _write(folder: Path, result: GapResult) -> None:
    """All files of a result, on the disk; the last one is the seal over the others."""
    frames = [
        getattr(trace, version).assign(recording=trace.recording, version=version)
        for trace in result.traces
        for version in VERSIONS
    ]
    if frames:
        pd.concat(frames, ignore_index=True).to_parquet(folder / TRACES, index=False)
    for experiment in result.experiments:
        write_experiment(folder / EXPERIMENTS, experiment)
    (folder / DIFFERENCE).write_text(result.machine_diff, "utf-8")
    (folder / RESULT).write_text(json_text(result.to_json()), "utf-8")
    (folder / SEAL).write_text(json_text({"schema": 1, "sha256": _digests(folder)}), "utf-8")
    for path in (*folder.rglob("*"), folder):
        on_disk(path)


def _digests(folder: Path) -> dict[str, str]:
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != SEAL)
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def _check_seal(folder: Path) -> None:
    """Refuse files that are not those that were written. Results of before there were seals have none.

    Raises:
        StoreError: names one of them.
    """
    try:
        sealed = dict(json.loads((folder / SEAL).read_text("utf-8"))["sha256"])
    except FileNotFoundError:
        return
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StoreError(folder / SEAL, f"not readable ({error})", "the seal as it was written", AGAIN) from None
    found = _digests(folder)
    changed = sorted(name for name in sealed if found.get(name) != sealed[name])
    if changed:
        what = "changed after it was written" if changed[0] in found else "the file is gone"
        raise StoreError(folder / changed[0], what, f"sha256 {str(sealed[changed[0]])[:12]}…", AGAIN)


def _result(values: dict[str, Any], traces: tuple[Traces, ...], experiments: tuple[Experiment, ...]) -> GapResult:
    for effect in values["effects"]:
        effect["aliases"] = [(alias["name"], alias["target"]) for alias in effect.get("aliases", [])]
        for key, left in effect.get("undetermined", {}).items():
            effect["parameters"][key], effect["interval95"][key] = left["in_plant"], left["interval95"]
        effect["undetermined"] = tuple(effect.get("undetermined", ()))
    return GapResult(
        dataset=values["dataset"],
        plant_before=values["plant"]["before"],
        plant_after=values["plant"]["after"],
        verdict=values["verdict"],
        effects=_many(NamedEffect, values["effects"]),
        unnamed=_many(Unnamed, values["unnamed"]),
        ambiguous=tuple(tuple((item["name"], item["target"]) for item in tie) for tie in values["ambiguous"]),
        next_experiment=tuple(values["next_experiment"]),
        gap=TypeAdapter(Gap).validate_python(values["gap"]),
        stage_gap=TypeAdapter(Gap).validate_python(values["stage_gap"]),
        excitation=_many(Excitation, values["excitation"]),
        held_out_recordings=tuple(values["held_out_recordings"]),
        seconds=values["seconds"],
        localised=_many(Localised, values["localised"]),
        shares=_many(Share, values.get("shares", [])),
        maps=_many(Map, values.get("maps", [])),
        candidates=_many(Candidate, values["candidates"]),
        traces=traces,
        notes=tuple(values["notes"]),
        experiments=experiments,
        settings=values["settings"],
        carried=_many(ResidualModelResult, values.get("carried", [])),
        world_gap=_world_gap(values.get("world_gap")),
        machine_diff=values.get("machine_diff", ""),
        promotion=_promotion(values.get("promotion")),
    )


def _world_gap(values: dict[str, Any] | float | None) -> WorldGap | None:
    if not isinstance(values, dict):
        return None
    world = {key: values.pop(key) for key in ("before", "after", "noise_floor")}
    return TypeAdapter(WorldGap).validate_python({"world": world, **values})


def _promotion(values: dict[str, Any] | float | None) -> Promotion | None:
    if not isinstance(values, dict):
        return None
    return TypeAdapter(Promotion).validate_python({key: value for key, value in values.items() if key != "promoted"})


def _many(cls: type[Any], items: list[Any]) -> tuple[Any, ...]:
    adapter = TypeAdapter(cls)
    return tuple(adapter.validate_python(item) for item in items)


def _traces(path: Path) -> tuple[Traces, ...]:
    if not path.is_file():
        return ()
    table = pd.read_parquet(path)
    found = []
    for recording in dict.fromkeys(table["recording"]):
        tables = []
        for version in VERSIONS:
            rows = table[(table["recording"] == recording) & (table["version"] == version)]
            # The three have different columns: those that only the others have are empty here.
            rows = rows.drop(columns=["recording", "version"]).dropna(axis="columns", how="all")
            tables.append(rows.reset_index(drop=True))
        measured, before, after = tables
        found.append(Traces(str(recording), measured, before, after))
    return tuple(found)


def _numbers(value: Any) -> Any:
    """JSON has no NaN: where a number is missing, it was not finite."""
    if isinstance(value, dict):
        return {key: _numbers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_numbers(item) for item in value]
    return math.nan if value is None else value
