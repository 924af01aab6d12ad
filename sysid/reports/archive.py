"""Keeps the answer of the gap workflow beside the models, so that a report can be made again without computing it again."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pandas as pd
from pydantic import TypeAdapter

from sysid.errors import SettingsError, StoreError
from sysid.files import json_text, written_whole
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
from sysid.parse import parse_json
from sysid.root import Root

RESULT, TRACES, DIFFERENCE = "result.json", "traces.parquet", "machine.diff"
VERSIONS = ("measured", "before", "after")


def save_gap(folder: Path, result: GapResult) -> Path:
    """Write ``result`` into ``folder``: traces and experiments first, the JSON last, each whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    root = Root(folder)
    frames = [
        getattr(trace, version).assign(recording=trace.recording, version=version)
        for trace in result.traces
        for version in VERSIONS
    ]
    if frames:
        with written_whole(root.output(TRACES)) as half:
            pd.concat(frames, ignore_index=True).to_parquet(half, index=False)
    else:
        root.remove(TRACES)
    for old in root.entries(EXPERIMENTS):  # those of the result before: nobody should execute them any more
        root.remove(f"{EXPERIMENTS}/{old}")
    for experiment in result.experiments:
        write_experiment(root.make(EXPERIMENTS), experiment)
    root.write(DIFFERENCE, result.machine_diff.encode("utf-8"))
    root.write(RESULT, json_text(result.to_json()).encode("utf-8"))
    return folder / RESULT


def load_gap(folder: Path) -> GapResult | None:
    """The result that :func:`save_gap` wrote into ``folder``; None where there is none.

    Raises:
        StoreError: the files are damaged.
    """
    path, root = folder / RESULT, Root(folder)
    if not path.is_file():
        return None
    try:
        values = _numbers(parse_json(root.read(RESULT)))
        experiments = tuple(read_experiment(root.path(item["file"])) for item in values.get("experiments", []))
        return _result(values, _traces(root.path(TRACES)), experiments)
    except (ValueError, KeyError, TypeError, AttributeError, SettingsError) as error:
        message = str(error).splitlines()[0]
        raise StoreError(path, f"not readable ({message})", "a result as it was written", "Run `sysid gap` again.") from None


def _result(values: dict[str, Any], traces: tuple[Traces, ...], experiments: tuple[Experiment, ...]) -> GapResult:
    for effect in values["effects"]:
        effect["aliases"] = [(alias["name"], alias["target"]) for alias in effect.get("aliases", [])]
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
