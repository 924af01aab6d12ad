"""Dataset versions and their raw files as items of the site, from manifests alone."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping

from sysid.datasets.versions.index import VersionIndex
from sysid.datasets.versions.manifest import Manifest
from sysid.display import fixed
from sysid.site.item import Fact, Item

#: Group of the facts that give each signal's SI unit.
SIGNALS = "Signals"
ROLES = {"fit": "fit", "select": "selection", "held_out": "held out"}


def dataset_items(index: VersionIndex, flights: Mapping[str, str]) -> Iterator[Item]:
    """Every dataset version, and the raw files of those that were ingested.

    Args:
        flights: sha256 of a flight log → key of its run.
    """
    for entry, manifest in index.survey():
        if manifest is None:
            yield Item("damaged", entry.reference, damage=entry.damage, summary=entry.damage)
            continue
        files = _files(manifest, flights)
        if files is not None:
            yield files
        yield _dataset(manifest, files)


def _files(manifest: Manifest, flights: Mapping[str, str]) -> Item | None:
    """The raw files that a version was ingested from; None if another version was split."""
    base, sources = manifest["base"], manifest["sources"]
    if not sources or (base is not None and base["by"] == "split"):
        return None
    digest = hashlib.sha256("".join(sorted(source["sha256"] for source in sources)).encode()).hexdigest()
    size = sum(source["size"] for source in sources)
    return Item(
        "logs",
        _reference(manifest),
        digest=digest,
        summary=f"{len(sources)} raw file{'s' * (len(sources) > 1)}, {_size(size)}",
        parents=tuple(flights[source["sha256"]] for source in sources if source["sha256"] in flights),
    )


def _dataset(manifest: Manifest, files: Item | None) -> Item:
    base = manifest["base"]
    parents = [files.key] if files is not None else []
    parents += [f"dataset:{manifest['name']}@{base['version']}"] if base is not None else []
    seconds = sum(item["rows"] / item["rate_hz"] for item in manifest["recordings"] if item["kind"] == "motion")
    poses = sum(item["rows"] for item in manifest["recordings"] if item["kind"] == "poses")
    content = [f"{fixed(seconds, 0)} s of motion"] * (seconds > 0.0) + [f"{poses} poses"] * (poses > 0)
    return Item(
        "dataset",
        _reference(manifest),
        created=manifest["created"][:16].replace("T", " "),
        digest=manifest["digest"],
        summary=f"{len(manifest['recordings'])} recordings, {', '.join(content)}",
        parents=tuple(parents),
        facts=tuple(_facts(manifest)),
    )


def _facts(manifest: Manifest) -> Iterator[Fact]:
    roles = Counter(ROLES[role] for role in manifest["splits"].values())
    yield Fact("Content", "machine", manifest["machine_name"])
    yield Fact("Content", "recordings", str(len(manifest["recordings"])))
    yield Fact("Content", "roles", ", ".join(f"{count} {role}" for role, count in roles.items()) or "none")
    yield Fact("Content", "raw files", str(len(manifest["sources"])))
    flags = manifest["quality"].get("flags", [])
    yield Fact("Content", "flagged sections", str(len(flags)))
    for item in manifest["recordings"]:
        role = ROLES.get(manifest["splits"].get(item["name"], ""), "no role")
        rows = f"{item['rows']} poses" if item["kind"] == "poses" else f"{item['rows'] / item['rate_hz']:.1f} s"
        yield Fact("Recordings", item["name"], f"{rows}, {role}, {len(item['signals'])} signals")
    for signal, unit in manifest["units"].items():
        yield Fact(SIGNALS, signal, unit)
    for clock in manifest["clocks"]:
        low, high = clock["offset_interval95"]
        text = f"{clock['offset_s']:+.6f} s ± {1e3 * (high - low) / 2.0:.3g} ms, {clock['skew_ppm']:+.1f} ppm"
        yield Fact("Clocks", f"{clock['recording']}, {clock['stream']}", text if clock["applied"] else f"not applied: {text}")


def _size(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"


def _reference(manifest: Manifest) -> str:
    return f"{manifest['name']}@{manifest['version']}"
