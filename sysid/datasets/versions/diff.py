"""Differences between two versions: sources, recipe, machine, clocks, roles, settings and values."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.datasets.versions.manifest import Manifest
from sysid.datasets.versions.store import Store
from sysid.names import uncut_name

#: Relative tolerance of quality figures.
SAME_SHARE = 1e-9


@dataclass(frozen=True)
class ValueChange:
    """A value in the first version and in the second; None where a version has none."""

    what: str
    before: Any
    after: Any


@dataclass(frozen=True)
class NameChanges:
    """Names only in the second version, only in the first, and in both with different content."""

    added: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.added or self.removed or self.changed)


@dataclass(frozen=True)
class ClockChange:
    """A clock record that differs between the versions; NaN where it was not applied.

    Args:
        mid_shift_s: shift of the stream against the machine's clock in the middle of the recording [s].
    """

    recording: str
    stream: str
    offset_s: tuple[float, float]
    skew_ppm: tuple[float, float]
    mid_shift_s: float
    applied: tuple[bool, bool]


@dataclass(frozen=True)
class SignalChange:
    """Difference of one signal of one recording, over the rows of both versions with the same ``time``.

    Args:
        rows: of the recording, in either version.
        missing: rows without a value, in either version.
        compared: rows with a value in both.
        largest, rms: of the difference, in ``unit``; NaN where nothing can be compared.
    """

    recording: str
    signal: str
    unit: str
    rows: tuple[int, int]
    missing: tuple[int, int]
    compared: int
    largest: float
    rms: float


@dataclass(frozen=True)
class DatasetDiff:
    """Differences between version ``before`` and version ``after``.

    Args:
        same_content: both have the same digest.
        texts: recipe and files of the machine → unified diff.
        recordings, sources, signals: recordings and signals by name, sources by path (changed: another sha256).
        units, splits, settings: by name; ``settings`` are those of resampling and versions of the code.
        tables: only the signals that differ.
        quality: figures of recordings that both have.
    """

    before: str
    after: str
    same_content: bool
    recordings: NameChanges
    sources: NameChanges
    signals: NameChanges
    texts: Mapping[str, str]
    units: tuple[ValueChange, ...]
    splits: tuple[ValueChange, ...]
    settings: tuple[ValueChange, ...]
    clocks: tuple[ClockChange, ...]
    tables: tuple[SignalChange, ...]
    quality: tuple[ValueChange, ...]

    @property
    def empty(self) -> bool:
        """Whether nothing differs."""
        found = (self.recordings, self.sources, self.signals, self.texts, self.units, self.splits, self.settings)
        return not any((*found, self.clocks, self.tables, self.quality))

    def to_json(self) -> dict[str, Any]:
        """Plain values, schema 1."""
        return {"schema": 1, **asdict(self)}


def diff(store: Store, before: str, after: str) -> DatasetDiff:
    """Differences of ``after`` from ``before``; each ``name`` or ``name@3``, also of two datasets.

    Raises:
        StoreError: no such version, or its files are damaged.
    """
    a, b = store.manifest(before), store.manifest(after)
    shared = [item["name"] for item in a["recordings"] if item["name"] in {other["name"] for other in b["recordings"]}]
    return DatasetDiff(
        before=f"{a['name']}@{a['version']}",
        after=f"{b['name']}@{b['version']}",
        same_content=a["digest"] == b["digest"],
        recordings=_names({item["name"]: None for item in a["recordings"]}, {item["name"]: None for item in b["recordings"]}),
        sources=_names({s["path"]: s["sha256"] for s in a["sources"]}, {s["path"]: s["sha256"] for s in b["sources"]}),
        signals=_names(dict.fromkeys(_signals(a)), dict.fromkeys(_signals(b))),
        texts=_texts(a, b),
        units=_changes({s: a["units"][s] for s in a["units"] if s in b["units"]}, b["units"], both=True),
        splits=_changes(a["splits"], b["splits"]),
        settings=_changes(_settings(a), _settings(b)),
        clocks=_clocks(a, b),
        tables=_tables(store, a, b, shared),
        quality=_quality(a, b, shared),
    )


def _names(before: Mapping[str, Any], after: Mapping[str, Any]) -> NameChanges:
    return NameChanges(
        added=tuple(name for name in after if name not in before),
        removed=tuple(name for name in before if name not in after),
        changed=tuple(name for name in before if name in after and before[name] != after[name]),
    )


def _changes(before: Mapping[str, Any], after: Mapping[str, Any], both: bool = False) -> tuple[ValueChange, ...]:
    names = [name for name in before if name in after] if both else list({**before, **after})
    pairs = ((name, before.get(name), after.get(name)) for name in names)
    return tuple(ValueChange(name, old, new) for name, old, new in pairs if old != new)


def _signals(manifest: Manifest) -> list[str]:
    return sorted({signal for item in manifest["recordings"] for signal in item["signals"]})


def _texts(a: Manifest, b: Manifest) -> dict[str, str]:
    def files(manifest: Manifest) -> dict[str, str]:
        recipes = {part["made"]["recipe"]: None for part in manifest["parts"]}
        return {"recipe.toml": "\n".join(text for text in recipes if text), **manifest["machine"]}

    ours, theirs = files(a), files(b)
    found = {}
    for name in {**ours, **theirs}:
        old, new = ours.get(name, ""), theirs.get(name, "")
        if old != new:
            one, other = (f"{m['name']}@{m['version']}/{name}" for m in (a, b))
            found[name] = "\n".join(difflib.unified_diff(old.splitlines(), new.splitlines(), one, other, lineterm=""))
    return found


def _settings(manifest: Manifest) -> dict[str, Any]:
    """Settings and software of the tables; where parts differ, a list of all values."""
    values: dict[str, list[Any]] = {}
    for part in manifest["parts"]:
        made = part["made"]
        own = {"sysid": made["sysid"], "ingest": made["ingest"], **dict(_leaves(made["settings"])), **made["software"]}
        for name, value in own.items():
            known = values.setdefault(name, [])
            if value not in known:
                known.append(value)
    return {name: found[0] if len(found) == 1 else found for name, found in values.items()}


def _clocks(a: Manifest, b: Manifest) -> tuple[ClockChange, ...]:
    lengths = {item["name"]: item["rows"] / item["rate_hz"] for item in a["recordings"]}

    def keyed(manifest: Manifest) -> dict[tuple[Any, ...], dict[str, Any]]:
        found: dict[tuple[Any, ...], dict[str, Any]] = {}
        for item in manifest["clocks"]:  # a clock that was set while it recorded has several records
            key = (item["recording"], item["stream"])
            found[(*key, sum(known[:2] == key for known in found))] = item
        return found

    ours, theirs = keyed(a), keyed(b)
    changes = []
    for key, old in ours.items():
        new = theirs.get(key)
        if new is None or new == old:
            continue
        offsets = (_number(old["offset_s"]), _number(new["offset_s"]))
        skews = (_number(old["skew_ppm"]), _number(new["skew_ppm"]))
        mid = 0.5 * lengths.get(key[0], 0.0)
        # An offset counts from the stream's first stamp.
        later = 1e-9 * (new["stream_start_ns"] - old["stream_start_ns"])
        shift = offsets[1] - offsets[0] - later + 1e-6 * (skews[1] - skews[0]) * mid
        applied = (bool(old["applied"]), bool(new["applied"]))
        changes.append(ClockChange(key[0], key[1], offsets, skews, shift, applied))
    return tuple(changes)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _tables(store: Store, a: Manifest, b: Manifest, shared: list[str]) -> tuple[SignalChange, ...]:
    ours, theirs = ({item["name"]: item for item in manifest["recordings"]} for manifest in (a, b))
    different = [name for name in shared if _place(a, ours[name]) != _place(b, theirs[name])]
    if not different:
        return ()
    before, after = (store.load(f"{manifest['name']}@{manifest['version']}") for manifest in (a, b))
    found = []
    for name in different:
        one, other = before.recording(name), after.recording(name)
        for signal in {**dict.fromkeys(one.signals), **dict.fromkeys(other.signals)}:
            change = _signal_change(one, other, signal, str(b["units"].get(signal, a["units"].get(signal, ""))))
            if change is not None:
                found.append(change)
    return tuple(found)


def _place(manifest: Manifest, item: Mapping[str, Any]) -> tuple[Any, ...]:
    """Folder and key, which are equal for the same rows of the same files."""
    return manifest["parts"][item["part"]]["folder"], item["key"]


def _signal_change(one: Recording, other: Recording, signal: str, unit: str) -> SignalChange | None:
    """None where the signal is the same in both."""
    a, b = one.values(signal), other.values(signal)
    if len(a) == len(b) and np.array_equal(a, b, equal_nan=True) and np.array_equal(one.values("time"), other.values("time")):
        return None
    at: npt.NDArray[np.int64]
    there: npt.NDArray[np.int64]
    if one.kind == "poses":
        rows = np.arange(len(a) if len(a) == len(b) else 0)
        at, there = rows, rows
    elif one.rate_hz == other.rate_hz:
        before, after = (np.rint(r.values("time") * r.rate_hz).astype(np.int64) for r in (one, other))
        _, at, there = np.intersect1d(before, after, return_indices=True)
    else:
        at = there = np.arange(0)
    difference = b[there] - a[at]
    difference = difference[~np.isnan(difference)]
    return SignalChange(
        recording=one.name,
        signal=signal,
        unit=unit,
        rows=(len(a), len(b)),
        missing=(int(np.isnan(a).sum()), int(np.isnan(b).sum())),
        compared=len(difference),
        largest=float(np.abs(difference).max()) if len(difference) else math.nan,
        rms=float(np.sqrt(np.mean(difference**2))) if len(difference) else math.nan,
    )


def _quality(a: Manifest, b: Manifest, shared: list[str]) -> tuple[ValueChange, ...]:
    whole = {*map(uncut_name, shared)} | {*shared}
    changes = []
    for section in (name for name in a["quality"] if name in b["quality"]):
        ours, theirs = a["quality"][section], b["quality"][section]
        if not isinstance(ours, Mapping) or not isinstance(theirs, Mapping):
            continue
        for recording in (name for name in ours if name in theirs and name in whole):
            old, new = dict(_leaves(ours[recording])), dict(_leaves(theirs[recording]))
            for key in {**old, **new}:
                if not _same(old.get(key), new.get(key)):
                    changes.append(ValueChange(f"{section}/{recording}/{key}", old.get(key), new.get(key)))
    return tuple(changes)


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Path → value of everything that is no mapping."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _leaves(item, f"{path}/{key}" if path else str(key))
    else:
        yield path, value


def _same(old: Any, new: Any) -> bool:
    if isinstance(old, float | int) and isinstance(new, float | int):
        return math.isclose(old, new, rel_tol=SAME_SHARE)
    return bool(old == new)
