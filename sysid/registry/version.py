"""Model versions: files, kind and lineage, addressed by the sha256 of all three; ancestors and descendants by lineages."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, get_args

from sysid.errors import SettingsError, StoreError, nearest
from sysid.names import check_name
from sysid.registry.promotion import PromotionDecision

Kind = Literal["actuator", "history", "motion", "forward", "plant", "policy"]
#: Kinds that `sysid fit` creates.
NETWORKS: tuple[str, ...] = ("actuator", "history", "motion", "forward")
KINDS: tuple[str, ...] = get_args(Kind)

#: Formats that execute nothing on reading: no pickle, no ``.pt``, no ``.npy`` (which may hold objects).
SUFFIXES = (".safetensors", ".json", ".diff")

#: File beside those of a version; its sha256 is the version's digest.
MANIFEST = "manifest.json"

#: Alias of the promoted version, to which a name alone refers.
CHAMPION = "champion"
#: Alias of the newest registered version that has not been promoted.
CANDIDATE = "candidate"

#: Largest value of a tag in every MLflow store [characters].
MAX_MANIFEST = 100_000


@dataclass(frozen=True)
class ModelVersion:
    """One immutable version.

    Args:
        name: of the model; all its versions are of one kind.
        version: counts from 1.
        kind: of the model, which determines the files.
        digest: sha256 of the manifest (kind, lineage, sha256 of every file): the content address.
        lineage: its sources: dataset version, recipe, seed, parent version.
        metrics: its figures; not part of the digest, because timings differ between equal runs.
        sha256: file name → digest of its content.
        aliases: names that refer to this version (``champion``).
        created_ms: time of registration, milliseconds since 1970.
        files: file name → content; filled only by ``Registry.load``, which checks it against ``sha256``.
        decisions: on its promotion, oldest first.
    """

    name: str
    version: int
    kind: Kind
    digest: str
    lineage: Mapping[str, Any]
    metrics: Mapping[str, float] = field(default_factory=dict)
    sha256: Mapping[str, str] = field(default_factory=dict)
    aliases: tuple[str, ...] = ()
    created_ms: int = 0
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)
    decisions: tuple[PromotionDecision, ...] = ()

    @property
    def reference(self) -> str:
        """``name@version``."""
        return f"{self.name}@{self.version}"

    def to_json(self) -> dict[str, Any]:
        """Everything but the files' content."""
        values = asdict(self)
        del values["files"]
        return values


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def manifest(kind: str, hashes: Mapping[str, str], lineage: Mapping[str, Any], where: object) -> str:
    """Kind, lineage and file digests as canonical JSON; its sha256 is the version's digest.

    Raises:
        SettingsError: the lineage has values that JSON does not (NaN, an array, a path), or is too long.
    """
    try:
        text = json.dumps(
            {"files": dict(hashes), "kind": kind, "lineage": dict(lineage)},
            sort_keys=True,
            separators=(",", ":"),
            allow_nan=False,
        )
    except (TypeError, ValueError) as error:
        raise SettingsError(
            f"{where}: lineage", str(error), "plain JSON values (finite numbers, text, lists, tables)"
        ) from None
    if len(text) > MAX_MANIFEST:
        raise SettingsError(
            f"{where}: lineage",
            f"{len(text)} characters of JSON",
            f"at most {MAX_MANIFEST}",
            "Put long tables into a JSON file of the model.",
        )
    return text


def check_kind(kind: str) -> None:
    if kind not in KINDS:
        raise SettingsError("model kind", repr(kind), nearest(kind, KINDS))


def check_files(files: Mapping[str, bytes], where: object) -> None:
    """Refuse file names that are paths, and formats that can execute code when they are read."""
    if not files:
        raise SettingsError(where, "no files", "at least one safetensors or JSON file")
    for name in files:
        check_name(name, f"{where}: file name")
        if not name.endswith(SUFFIXES):
            raise SettingsError(
                f"{where}: file name", repr(name), f"a file that ends in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}"
            )


def split_reference(reference: str) -> tuple[str, str | None]:
    """``"autolog@3"`` → ``("autolog", "3")``; ``"autolog"`` → ``("autolog", None)``.

    Raises:
        SettingsError: more than one ``@``, or an empty part.
    """
    name, separator, selector = reference.partition("@")
    if not name or (separator and not selector) or "@" in selector:
        raise SettingsError("model reference", repr(reference), "name, name@3 or name@champion")
    check_name(name)
    return name, selector or None


def choose(numbers: Sequence[int], aliases: Mapping[str, int], name: str, selector: str | None) -> int:
    """The version that ``selector`` (a number or an alias) selects; for None the champion, or the newest if there is none.

    Args:
        numbers: of all versions, at least one.
        aliases: alias → version; aliases of deleted versions are ignored.

    Raises:
        StoreError: no such version; lists the existing ones.
    """
    known = {alias: number for alias, number in aliases.items() if number in numbers}
    newest = max(numbers)
    if selector is None:
        return known.get(CHAMPION, newest)
    if selector.isdecimal() and str(int(selector)) == selector and int(selector) in numbers:
        return int(selector)
    if selector in known:
        return known[selector]
    there = f"versions {min(numbers)} to {newest}" if len(numbers) > 1 else f"version {newest}"
    expected = there if selector.isdigit() else f"{there}, or an alias: {nearest(selector, known)}"
    raise StoreError(f"model {name}", f"no version or alias {selector!r}", expected)


def dataset_descendants(versions: Sequence[ModelVersion], reference: str, digest: str) -> tuple[ModelVersion, ...]:
    """Those of ``versions`` that were made from a dataset version, directly or indirectly."""
    wanted = {reference, digest} - {""}
    direct = {version.reference for version in versions if wanted & {*_named_in(version.lineage, datasets=True)}}
    reached = _followed(versions, direct)
    return tuple(version for version in versions if version.reference in reached)


def descendants(versions: Sequence[ModelVersion], reference: str) -> tuple[ModelVersion, ...]:
    """Those of ``versions`` that were made from a model version, directly or indirectly."""
    reached = _followed(versions, {reference}) - {reference}
    return tuple(version for version in versions if version.reference in reached)


def ancestors(versions: Sequence[ModelVersion], version: ModelVersion) -> tuple[ModelVersion, ...]:
    """The model versions that a version was made from, directly or indirectly."""
    by_reference = {other.reference: other for other in versions}
    found: dict[str, ModelVersion] = {}
    open_ends = [version]
    while open_ends:
        for name in _named_in(open_ends.pop().lineage, datasets=False):
            if name in by_reference and name not in found and name != version.reference:
                found[name] = by_reference[name]
                open_ends.append(by_reference[name])
    return tuple(found.values())


def sources(version: ModelVersion) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The dataset versions and the model versions that a lineage names, and other texts: compare them with known references."""
    return tuple(_named_in(version.lineage, datasets=True)), tuple(_named_in(version.lineage, datasets=False))


def _followed(versions: Sequence[ModelVersion], reached: set[str]) -> set[str]:
    parents = {version.reference: {*_named_in(version.lineage, datasets=False)} for version in versions}
    while more := {name for name, own in parents.items() if name not in reached and own & reached}:
        reached = reached | more
    return reached


def _named_in(value: Any, datasets: bool, key: str = "") -> Iterator[str]:
    """The texts of a lineage at any depth, of keys with ``dataset`` or of all others.

    The keys are needed because a plant and a dataset may have the same name.
    """
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _named_in(item, datasets, str(name))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _named_in(item, datasets, key)
    elif isinstance(value, str) and ("dataset" in key) == datasets:
        yield value
