"""The manifest of a dataset version: one JSON file with its tables and their provenance.

It is written once. Its seal is the sha256 of everything else, so that later changes of roles or units are detected.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import platform
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal

from sysid.datasets.clocks import ClockRecord
from sysid.datasets.versions.manifest_shape import check_shape
from sysid.errors import SettingsError, StoreError
from sysid.extras import versions_of
from sysid.files import plain
from sysid.foreign import MAX_NAME, shown, visible
from sysid.names import uncut_name
from sysid.parse import parse_json
from sysid.release import __version__

if TYPE_CHECKING:
    from sysid.datasets.recording import Dataset

Manifest = dict[str, Any]

#: Of the manifests written now; older ones are migrated by :data:`MIGRATIONS`.
SCHEMA = 2
#: Libraries that affect the tables.
SOFTWARE = ("numpy", "scipy", "pandas", "pyarrow", "deltalake")

Change = Literal["append", "split", "update"]


@dataclass(frozen=True)
class PartRecord:
    """Settings with which raw files became tables.

    Args:
        ingest: ``INGEST_VERSION`` of the code.
        recipe: text of the recipe, empty where the columns have canonical names.
        settings: of resampling, by name.
        mounts: files of the recipe's stream → rigid body → its pose on its link (4×4, row by row), where one reference pose
            holds for all recordings.
    """

    ingest: int
    recipe: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    mounts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Superseded:
    """The recordings that a version does not take over from the one before, by their names before they were cut into blocks.

    Args:
        by: recording → the one that stands for it: of the same name with other content, or one that contains all of it.
        beginnings: recording → contents that are its beginning, each as the sha256 of its files: cut copies of it.
    """

    by: Mapping[str, str] = field(default_factory=dict)
    beginnings: Mapping[str, list[list[str]]] = field(default_factory=dict)


def files_of(sources: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, Mapping[str, Any]]]:
    """Recording before it was cut into blocks → its raw files by name, from the ``sources`` of a manifest."""
    files: dict[str, dict[str, Mapping[str, Any]]] = {}
    for source in sources:
        recording, _, file = source["path"].rpartition("/")
        files.setdefault(recording, {})[file] = source
    return files


def contents_of(manifest: Manifest) -> dict[str, str]:
    """Recording before it was cut into blocks → digest of its raw files."""
    files = files_of(manifest["sources"]).items()
    return {name: digest_of({"files": sorted((file, entry["sha256"]) for file, entry in own.items())}) for name, own in files}


def digest_of(content: Mapping[str, Any]) -> str:
    """The content address of plain JSON values: their sha256, independent of the order of keys."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode("utf-8")).hexdigest()


def new_manifest(dataset: Dataset, version: int, part: Mapping[str, Any]) -> Manifest:
    """A version of one part, made by one ingest."""
    return {
        "schema": SCHEMA,
        "name": dataset.name,
        "version": version,
        "digest": dataset.digest,
        "created": _now(),
        "sysid": __version__,
        "base": None,
        "machine_name": dataset.machine.name,
        "machine": dataset.machine.files(),
        "parts": [part],
        "recordings": _recordings(dataset, 0),
        "units": dict(dataset.units),
        "splits": dict(dataset.splits),
        "sources": [dataclasses.asdict(source) for source in dataset.sources],
        "streams": {stream: list(signals) for stream, signals in dataset.streams.items()},
        "clocks": [plain(dataclasses.asdict(clock)) for clock in dataset.clocks],
        "quality": plain(dataset.quality),
    }


def new_part(folder: str, samples: Mapping[str, Any], channels: Mapping[str, Any], made: PartRecord) -> Manifest:
    """The tables of one ingest, with their provenance."""
    return {
        "folder": folder,
        "samples": samples,
        "channels": channels,
        "made": {
            "created": _now(),
            "sysid": __version__,
            "python": platform.python_version(),
            "software": versions_of(SOFTWARE),
            **plain(dataclasses.asdict(made)),
        },
    }


def appended(
    base: Manifest, addition: Dataset, version: int, part: Mapping[str, Any], superseded: Superseded | None = None
) -> Manifest:
    """``base`` with the recordings of ``addition`` behind its own, or in the place of those that they supersede.

    Args:
        addition: the new recordings, their units, roles, sources, clocks and streams; its quality is that of all recordings.
    """
    if superseded is None:
        start = _changed(base, version, addition.digest, "append")
    else:
        start = reduced(base, version, addition.digest, superseded)
    streams = {stream: list(signals) for stream, signals in base["streams"].items()}
    for stream, signals in addition.streams.items():
        known = streams.setdefault(stream, [])
        known += [signal for signal in signals if signal not in known]
    more = new_manifest(addition, version, part)
    entries = _recordings(addition, len(start["parts"]))
    return {
        **start,
        "parts": [*start["parts"], part],
        "recordings": _in_places(base, start["recordings"], entries, superseded or Superseded()),
        "units": {**base["units"], **more["units"]},
        "splits": {**start["splits"], **more["splits"]},
        "sources": [*start["sources"], *more["sources"]],
        "streams": dict(sorted(streams.items())),
        "clocks": [*start["clocks"], *more["clocks"]],
        "quality": more["quality"],
    }


def reduced(base: Manifest, version: int, digest: str, superseded: Superseded) -> Manifest:
    """``base`` without the recordings that are superseded. Parts without a recording are left out."""
    sourced = files_of(base["sources"])

    def stays(name: str) -> bool:
        return uncut_name(name, sourced) not in superseded.by

    recordings = [item for item in base["recordings"] if stays(item["name"])]
    places = {old: new for new, old in enumerate(sorted({item["part"] for item in recordings}))}
    parts = []
    for old in places:
        gone = {uncut_name(item["name"], sourced) for item in base["recordings"] if item["part"] == old} & {*superseded.by}
        gone |= {*base["parts"][old].get("superseded", ())}
        parts.append({**base["parts"][old], **({"superseded": sorted(gone)} if gone else {})})
    return {
        **_changed(base, version, digest, "update"),
        "parts": parts,
        "recordings": [{**item, "part": places[item["part"]]} for item in recordings],
        "splits": {name: role for name, role in base["splits"].items() if stays(name)},
        "sources": [source for source in base["sources"] if stays(source["path"].rpartition("/")[0])],
        "clocks": [clock for clock in base["clocks"] if stays(clock["recording"])],
        "quality": {key: _reduced_quality(value, stays) for key, value in base["quality"].items()},
        "beginnings": dict(superseded.beginnings),
    }


def _reduced_quality(value: Any, stays: Callable[[str], bool]) -> Any:
    """Entries by recording, or rows that name one, of the recordings that stay."""
    if isinstance(value, Mapping):
        return {name: entry for name, entry in value.items() if stays(name)}
    if isinstance(value, list):
        return [row for row in value if not (isinstance(row, Mapping) and "recording" in row and not stays(row["recording"]))]
    return value


def _in_places(base: Manifest, stay: list[Manifest], new: list[Manifest], superseded: Superseded) -> list[Manifest]:
    """The entries of all recordings: a new one is in the place of the first that it supersedes, or at the end."""
    sourced = files_of(base["sources"])
    staying = {item["name"]: item for item in stay}
    waiting: dict[str, list[Manifest]] = {}
    for item in new:
        waiting.setdefault(uncut_name(item["name"], {*superseded.by.values()}), []).append(item)
    entries: list[Manifest] = []
    for item in base["recordings"]:
        by = superseded.by.get(uncut_name(item["name"], sourced))
        entries += [staying[item["name"]]] if by is None else waiting.pop(by, [])
    return entries + [item for own in waiting.values() for item in own]


def resplit(base: Manifest, splits: Mapping[str, str], digest: str, version: int) -> Manifest:
    """``base`` with other roles; the tables are the same files."""
    manifest = _changed(base, version, digest, "split")
    manifest["base"]["origin"] = _before_splits(base)
    return {**manifest, "splits": dict(splits)}


def split_digest(base: Manifest, splits: Mapping[str, str]) -> str:
    """Content address of ``base`` with other roles, independent of the steps that led to them."""
    origin = _before_splits(base)
    if dict(splits) == origin["splits"]:
        return str(origin["digest"])
    return digest_of({"split": origin["digest"], "roles": dict(splits)})


def _before_splits(manifest: Manifest) -> Manifest:
    """Digest and roles of the first version with these tables."""
    if manifest["base"] is not None and manifest["base"]["by"] == "split":
        return dict(manifest["base"]["origin"])
    return {"digest": manifest["digest"], "splits": manifest["splits"]}


def _changed(base: Manifest, version: int, digest: str, by: Change) -> Manifest:
    return {
        **base,
        "version": version,
        "digest": digest,
        "created": _now(),
        "sysid": __version__,
        "base": {"version": base["version"], "digest": base["digest"], "by": by},
    }


def _recordings(dataset: Dataset, part: int) -> list[Manifest]:
    """``key`` is the value of column ``recording`` in the part's samples."""
    return [
        {
            "name": r.name,
            "kind": r.kind,
            "rate_hz": r.rate_hz,
            "start_ns": r.start_ns,
            "rows": len(r),
            "signals": list(r.signals),
            "part": part,
            "key": r.name,
        }
        for r in dataset.recordings
    ]


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def to_text(manifest: Manifest) -> str:
    """The manifest as JSON, sealed."""
    return json.dumps({**manifest, "seal": _seal(manifest)}, indent=1, allow_nan=False)


def from_text(content: bytes, where: object) -> Manifest:
    """A manifest of any schema up to :data:`SCHEMA`, migrated to the newest.

    Raises:
        StoreError: cut off, changed after it was written, or of a newer sysid.
    """
    try:
        manifest: Manifest = parse_json(content)
        schema = manifest["schema"]
    except (ValueError, TypeError, KeyError) as error:
        raise _damaged(where, f"damaged ({error or type(error).__name__})") from None
    if not isinstance(schema, int) or not 1 <= schema <= SCHEMA:
        written_by = visible(manifest.get("sysid", "?"), MAX_NAME)
        found, expected = f"schema {shown(schema)}, written by sysid {written_by}", f"schema 1 to {SCHEMA}"
        raise StoreError(where, found, expected, "Use the sysid that wrote it, or a newer one.")
    if schema > 1 and manifest.pop("seal", None) != _seal(manifest):
        raise _damaged(where, "changed after it was written: its seal does not fit")
    try:
        for older, migrate in MIGRATIONS:
            if manifest["schema"] == older:
                manifest = migrate(manifest)
        check_shape(manifest)
        for clock in manifest["clocks"]:
            clock_from(clock)
    except (KeyError, AttributeError) as error:
        raise _damaged(where, f"damaged (without {error})") from None
    except (ValueError, TypeError, SettingsError) as error:
        raise _damaged(where, f"damaged ({error})") from None
    return manifest


def _seal(manifest: Manifest) -> str:
    return digest_of({key: value for key, value in manifest.items() if key != "seal"})


def _damaged(where: object, found: str) -> StoreError:
    remedy = "The tables are untouched. Restore the file, or ingest the same logs again: they become a new version."
    return StoreError(where, found, "a manifest as it was written", remedy)


def _with_parts(old: Manifest) -> Manifest:
    """1 → 2: one folder of tables becomes a list of parts; recordings are numbered in their tables, without sha256."""
    manifest = {"base": None, "streams": {}, **old, "schema": 2}
    folder, recipe = manifest.pop("folder"), manifest.pop("recipe")
    made = {"created": old["created"], "sysid": old["sysid"], "ingest": 1, "recipe": recipe}
    unknown = {"python": "", "software": {}, "settings": {}, "mounts": {}}
    manifest["parts"] = [{"folder": folder, "samples": None, "channels": None, "made": {**made, **unknown}}]
    manifest["recordings"] = [{**item, "part": 0, "key": number} for number, item in enumerate(old["recordings"])]
    return manifest


#: (schema, function to the next schema), oldest first.
MIGRATIONS: tuple[tuple[int, Callable[[Manifest], Manifest]], ...] = ((1, _with_parts),)


def clock_from(item: Mapping[str, Any]) -> ClockRecord:
    """A clock record from JSON, in which NaN and infinity are null."""
    values: dict[str, Any] = {key: float("nan") if value is None else value for key, value in item.items()}
    for key in ("offset_interval95", "skew_interval95"):
        low, high = (float("nan") if end is None else float(end) for end in item[key])
        values[key] = (low, high)
    values["used_signals"] = tuple(item["used_signals"])
    return ClockRecord(**values)
