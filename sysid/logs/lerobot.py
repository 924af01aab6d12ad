"""LeRobot datasets, versions 2 and 3: Parquet files with several episodes each, a stream an episode.

``meta/info.json`` states the features and the names of their elements; ``data/chunk-*/*.parquet`` holds a list a row for each
feature, ``episode_index``, and ``timestamp`` [s] since the beginning of the episode (Hugging Face, *LeRobotDataset v3.0*).
Units are those of the recorder: degrees, radians or shares of the range; the file does not state which.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.logs.labels import bracketed
from sysid.logs.limits import MAX_TEXT
from sysid.logs.parquet import reading_parquet
from sysid.logs.reader import LogReader, ReadOptions, Stream
from sysid.parse import parse_json

Array = npt.NDArray[np.float64]

#: Kind of a stream.
KIND = "LeRobot episode"
DATA_FILE = "a data file of a LeRobot dataset"
#: Versions of the layout that are read.
VERSIONS = ("v2.", "v3.")
_INFO = "meta/info.json"
#: Features that every dataset has.
EPISODE, TIME = "episode_index", "timestamp"
#: How the types of numbers and flags begin.
_NUMBERS = ("float", "int", "uint", "bool")
#: Relative resolution of the stamps, which are stored in single precision.
_SINGLE = float(np.finfo(np.float32).eps)


class LeRobotReader(LogReader):
    """Numbers and flags of every feature; matrices, images, videos and texts are said to be left out."""

    name = "lerobot"
    suffixes = (".parquet",)
    clocks = ("episode",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        info = dataset_info(path)
        if info is None:
            raise InputError(path, "no meta/info.json above it", "a file data/chunk-…/….parquet of a LeRobot dataset")
        names, unread = feature_names(info, path)
        columns = _read(path, names, options)
        episodes = columns.pop(EPISODE).astype(np.int64)
        stamps = seconds_of(columns.pop(TIME), float(info.get("fps") or 0.0))
        bounds = episode_rows(episodes, path)
        options.check_streams(path, [episode_name(k) for k in bounds], "episode")
        known = tuple(label for label in names if options.columns is not None)
        return tuple(
            Stream(
                name=episode_name(episode),
                source=path,
                stamps={"episode": np.round(1e9 * stamps[rows]).astype(np.int64)},
                columns={label: values[rows] for label, values in columns.items()},
                fields=known,
                kind=KIND,
                unread=unread,
            )
            for episode, rows in bounds.items()
            if options.wants(episode_name(episode))
        )


def episode_name(episode: int) -> str:
    """The stream and recording of an episode: ``episode-000012``."""
    return f"episode-{episode:06d}"


def is_lerobot(folder: Path) -> bool:
    """Whether a folder is a LeRobot dataset."""
    return (folder / _INFO).is_file() and (folder / "data").is_dir()


def data_files(folder: Path) -> list[Path]:
    """The data files of a LeRobot dataset, in the order of their episodes."""
    return sorted((folder / "data").glob("chunk-*/*.parquet"))


def dataset_info(path: Path) -> dict[str, Any] | None:
    """``meta/info.json`` of the dataset to which a data file belongs; None where it belongs to none.

    Raises:
        InputError: not JSON, or a version that is not read.
    """
    if len(path.parents) < 3 or path.parents[1].name != "data":
        return None
    file = path.parents[2] / _INFO
    if not file.is_file():
        return None
    if file.stat().st_size > MAX_TEXT:
        raise InputError(file, f"{file.stat().st_size} bytes", "the description of a dataset")
    try:
        info = parse_json(file.read_bytes())
    except ValueError as error:
        raise InputError(file, f"not readable as JSON ({error})", "the description of a LeRobot dataset") from None
    version = info.get("codebase_version") if isinstance(info, dict) else None
    if not isinstance(info, dict) or not isinstance(version, str) or not version.startswith(VERSIONS):
        raise InputError(file, f"codebase_version {version!r}", "v2.0, v2.1 or v3.0", "Convert it with LeRobot.")
    return info


def feature_names(info: Mapping[str, Any], path: Path) -> tuple[dict[str, tuple[str, int]], dict[str, str]]:
    """Column of a stream, ``feature[element]`` or ``feature`` → its feature and the place in its list; and the other features.

    An element is labelled by its name as an element of a message is (:func:`sysid.logs.labels.bracketed`), else by its place.

    Raises:
        InputError: no features, or more elements of one than a list may have.
    """
    features = info.get("features")
    if not isinstance(features, dict):
        raise InputError(path, "no features in meta/info.json", "the features of a LeRobot dataset")
    found: dict[str, tuple[str, int]] = {}
    unread: dict[str, str] = {}
    for feature, about in features.items():
        if feature in (EPISODE, TIME):
            continue
        kind, shape = (about.get("dtype"), about.get("shape")) if isinstance(about, dict) else (None, None)
        if not str(kind).startswith(_NUMBERS):
            unread[feature] = f"values of type {kind}"
            continue
        if not isinstance(shape, list) or len(shape) != 1:
            unread[feature] = f"arrays of shape {shape}"
            continue
        count = shape[0]
        if not isinstance(count, int) or not 0 < count <= 16_384:
            raise InputError(path, f"feature {feature!r} of shape {shape}", "one number, the length of its list")
        names = _flat(about.get("names"))
        labels = bracketed(tuple(names)) if len(names) == count else ("",) * count
        own = [f"{feature}[{label or k}]" for k, label in enumerate(labels)] if count > 1 else [feature]
        found |= {label: (feature, k) for k, label in enumerate(own)}
    return found, unread


def _flat(names: object) -> list[str]:
    """The names of the elements: a list, or lists by kind (``{"motors": […]}``)."""
    if isinstance(names, dict):
        return [name for part in names.values() for name in _flat(part)]
    return [str(name) for name in names] if isinstance(names, list) else []


def _read(path: Path, names: Mapping[str, tuple[str, int]], options: ReadOptions) -> dict[str, Array]:
    """The wanted columns, and those of episodes and stamps, (n,) each.

    Raises:
        InputError: not Parquet, a column that is missing, or lists of another length than stated.
    """
    wanted = {label: place for label, place in names.items() if options.columns is None or label in options.columns}
    budget = options.budget_of(path, "a Parquet file", None)
    with reading_parquet(path, DATA_FILE) as file:
        rows, present = file.metadata.num_rows, set(file.schema_arrow.names)
        for needed in (EPISODE, TIME, *(feature for feature, _ in wanted.values())):
            if needed not in present:
                raise InputError(path, f"no column {needed!r}", "the features of meta/info.json")
        counts = {feature: 1 + max(k for name, k in names.values() if name == feature) for feature, _ in wanted.values()}
        budget.check_columns(path, 2 + sum(counts.values()))
        budget.check_numbers(path, rows * (2 + sum(counts.values())))
        lists = {feature: feature_values(file, feature, rows, count, path) for feature, count in counts.items()}
        own = {key: feature_values(file, key, rows, 1, path)[:, 0] for key in (EPISODE, TIME)}
    return {**own, **{label: lists[feature][:, k].copy() for label, (feature, k) in wanted.items()}}


def feature_values(file: Any, feature: str, rows: int, count: int, path: Path) -> Array:
    """A feature as a table, (n, count)."""
    import pyarrow as pa

    out, done = np.empty((rows, count)), 0
    for group in range(file.metadata.num_row_groups):
        for chunk in file.read_row_group(group, [feature]).column(feature).chunks:
            flat = chunk.flatten() if pa.types.is_nested(chunk.type) else chunk
            values = flat.cast(pa.float64()).to_numpy(zero_copy_only=False)
            if len(values) != len(chunk) * count:
                raise InputError(path, f"{feature}: lists of another length than {count}", "the shape of meta/info.json")
            out[done : done + len(chunk)] = values.reshape(-1, count)
            done += len(chunk)
    if done != rows:
        raise ValueError(f"{done} rows instead of {rows}")
    return out


def episode_rows(episodes: npt.NDArray[np.int64], path: Path) -> dict[int, slice]:
    """Episode → its rows.

    Raises:
        InputError: no rows, or rows of an episode that are not together.
    """
    if not len(episodes):
        raise InputError(path, "no rows", "the frames of an episode")
    edges = [0, *(np.flatnonzero(np.diff(episodes)) + 1), len(episodes)]
    numbers = [int(episodes[edge]) for edge in edges[:-1]]
    if len({*numbers}) < len(numbers) or min(numbers) < 0:
        raise InputError(path, "rows of one episode in several places", "its frames one after another")
    return {k: slice(int(a), int(b)) for k, a, b in zip(numbers, edges, edges[1:], strict=False)}


def seconds_of(stamps: Array, rate_hz: float) -> Array:
    """Stamps [s]; where they are frames over the rate, up to single precision, exactly those."""
    if rate_hz <= 0.0:
        return stamps
    frames = np.round(stamps * rate_hz)
    even = np.abs(stamps - frames / rate_hz) <= 2.0 * _SINGLE * np.maximum(np.abs(stamps), 1.0 / rate_hz)
    return frames / rate_hz if bool(even.all()) else stamps
