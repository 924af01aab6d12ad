"""A LeRobot dataset written again with some of its features later, for instance actions as late as the motion follows them.

Everything else is copied. Statistics of what changed are computed again: those of the whole (``meta/stats.json``), and those of
the episodes (``meta/episodes_stats.jsonl`` in version 2.1, columns ``stats/…`` of ``meta/episodes`` in version 3).
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, SettingsError, nearest
from sysid.logs.lerobot import (
    DATA_FILE,
    EPISODE,
    TIME,
    data_files,
    dataset_info,
    episode_rows,
    feature_names,
    feature_values,
    seconds_of,
)
from sysid.logs.parquet import reading_parquet
from sysid.parse import parse_json

if TYPE_CHECKING:
    import pyarrow as pa

Array = npt.NDArray[np.float64]
#: Episode → feature → its values, (n, k).
Changed = dict[int, dict[str, Array]]


def write_shifted(folder: Path, out: Path, delays: Mapping[str, float]) -> None:
    """Write the LeRobot dataset in ``folder`` to ``out`` with some elements of its features later.

    Values are interpolated between the frames of their episode, those of whole numbers and flags are of the nearest frame. Its
    first value is held before an episode, its last one after it.

    Args:
        out: a folder that is not there yet.
        delays: ``feature[element]`` as :class:`~sysid.logs.lerobot.LeRobotReader` names it → by how much it becomes later [s].

    Raises:
        InputError: no LeRobot dataset, or a file that is not readable.
        SettingsError: no such element, or ``out`` is there, or in ``folder``.
    """
    files = data_files(folder)
    info = dataset_info(files[0]) if files else None
    if info is None:
        raise InputError(folder, "no LeRobot dataset", "a folder with meta/info.json and data/chunk-*/*.parquet")
    names, _ = feature_names(info, folder)
    for label in delays:
        if label not in names:
            raise SettingsError(f"{folder}", f"no element {label!r}", nearest(label, names))
    if out.exists() or out.resolve().is_relative_to(folder.resolve()):
        found = "is there already" if out.exists() else f"is in {folder}"
        raise SettingsError(f"{out}", found, "a new folder beside it", "Give another folder with --out.")
    half = out.with_name(f".{out.name}.part")
    shutil.rmtree(half, ignore_errors=True)
    try:
        shutil.copytree(folder, half)
        changed = Changed()
        for file in files:
            changed |= _rewritten(file, half / file.relative_to(folder), names, delays, float(info.get("fps") or 0.0))
        _update_statistics(half, changed)
        half.replace(out)
    except BaseException:
        shutil.rmtree(half, ignore_errors=True)
        raise


def _rewritten(
    path: Path, out: Path, names: Mapping[str, tuple[str, int]], delays: Mapping[str, float], rate_hz: float
) -> Changed:
    """Write a data file to ``out``; returns the features that changed."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with reading_parquet(path, DATA_FILE) as file:
        table, rows = file.read(), file.metadata.num_rows
        counts = {feature: 1 + max(k for other, k in names.values() if other == feature) for feature, _ in names.values()}
        episodes = episode_rows(feature_values(file, EPISODE, rows, 1, path)[:, 0].astype(np.int64), path)
        time = seconds_of(feature_values(file, TIME, rows, 1, path)[:, 0], rate_hz)
        features = {names[label][0] for label in delays}
        values = {feature: feature_values(file, feature, rows, counts[feature], path) for feature in features}
    for label, delay in delays.items():
        feature, k = names[label]
        kind = table.schema.field(feature).type
        smooth = pa.types.is_floating(kind.value_type if pa.types.is_nested(kind) else kind)
        for here in episodes.values():
            values[feature][here, k] = _later(time[here], values[feature][here, k], delay, smooth)
    for feature, own in values.items():
        place = table.schema.get_field_index(feature)
        table = table.set_column(place, table.schema.field(place), _column(own, table.schema.field(place).type))
    pq.write_table(table, out)
    return {episode: {feature: own[here] for feature, own in values.items()} for episode, here in episodes.items()}


def _later(time: Array, values: Array, delay: float, smooth: bool) -> Array:
    if smooth:
        return np.interp(time - delay, time, values)
    nearest_frame = np.rint(np.interp(time - delay, time, np.arange(len(time)))).astype(np.intp)
    return values[nearest_frame]


def _column(values: Array, kind: pa.DataType) -> pa.Array:
    """A table (n, k) as a column of lists, or of numbers, of the type ``kind``."""
    import pyarrow as pa

    nested = pa.types.is_nested(kind)
    number = kind.value_type if nested else kind
    rows = values if nested else values[:, 0]
    return pa.array(rows.astype(number.to_pandas_dtype()).tolist(), type=kind)


def _update_statistics(folder: Path, changed: Changed) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    features = {feature for own in changed.values() for feature in own}
    whole = folder / "meta/stats.json"
    if whole.is_file():
        stated = parse_json(whole.read_bytes())
        for feature in features & stated.keys():
            stated[feature] = _statistics(np.concatenate([own[feature] for own in changed.values()]), stated[feature])
        whole.write_text(json.dumps(stated, indent=4), "utf-8")
    by_episode = folder / "meta/episodes_stats.jsonl"
    if by_episode.is_file():
        lines = [parse_json(line) for line in by_episode.read_bytes().splitlines() if line.strip()]
        for line in lines:
            own = changed.get(line["episode_index"], {})
            line["stats"] |= {f: _statistics(own[f], line["stats"][f]) for f in own.keys() & line["stats"].keys()}
        by_episode.write_text("".join(f"{json.dumps(line)}\n" for line in lines), "utf-8")
    for path in sorted((folder / "meta/episodes").glob("chunk-*/*.parquet")):
        table = pq.read_table(path)
        numbers = table.column(EPISODE).to_pylist()
        for place, field in enumerate(table.schema):
            match = re.fullmatch(r"stats/(.+)/([a-z0-9]+)", field.name)
            if match is not None and match[1] in features:
                stated = table.column(place).to_pylist()
                pairs = zip(numbers, stated, strict=True)
                new = [
                    _statistics(changed[n][match[1]], {match[2]: old})[match[2]] if n in changed else old for n, old in pairs
                ]
                table = table.set_column(place, field, pa.array(new, type=field.type))
        pq.write_table(table, path)


def _statistics(values: Array, stated: Mapping[str, Any]) -> dict[str, Any]:
    """The stated statistics of a feature (n, k) anew: min, max, mean, std, count, and quantiles (``q01``).

    Raises:
        InputError: one that is not known, which would not belong to the values any more.
    """
    found = dict[str, Any]()
    for key in stated:
        if key == "count":
            found[key] = [len(values)]
        elif key in ("min", "max", "mean", "std"):
            found[key] = getattr(np, key)(values, axis=0).tolist()
        elif re.fullmatch(r"q\d\d", key):
            found[key] = np.quantile(values, int(key[1:]) / 100.0, axis=0).tolist()
        else:
            raise InputError("the statistics of a LeRobot dataset", f"{key!r}", "min, max, mean, std, count, or q01 to q99")
    return found
