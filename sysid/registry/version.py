"""What a model version is: files, kind and lineage, addressed by the sha256 of all three."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from sysid.errors import SettingsError, StoreError, nearest
from sysid.names import check_name
from sysid.registry.decision import PromotionDecision

Kind = Literal["actuator", "history", "motion", "forward", "plant", "policy"]
#: Those that `sysid fit` makes.
NETWORKS: tuple[str, ...] = ("actuator", "history", "motion", "forward")
KINDS: tuple[str, ...] = get_args(Kind)

#: Nothing that is executed on reading: no pickle, no ``.pt``, no ``.npy`` (which may hold objects). A ``.diff`` is for people.
SUFFIXES = (".safetensors", ".json", ".diff")

#: Of a version's files, beside them; its sha256 is the version's digest.
MANIFEST = "manifest.json"

#: The alias of the version that a name alone means, because it was promoted.
CHAMPION = "champion"
#: The alias of the newest version that was registered and has not been promoted.
CANDIDATE = "candidate"

#: What every MLflow store accepts as the value of one tag.
LARGEST_MANIFEST = 100_000

_VERSION = re.compile(r"v?[0-9]+")


@dataclass(frozen=True)
class ModelVersion:
    """One immutable version.

    Args:
        name: of the model; all its versions are of one kind.
        version: counts from 1.
        kind: what reads the files.
        digest: sha256 of the manifest (kind, lineage, sha256 of every file): the content address.
        lineage: what it was made from: dataset version, recipe, seed, parent version.
        metrics: figures that describe it; not part of the digest, since timings differ between equal runs.
        sha256: file name → digest of its content.
        aliases: names that point to this version now (``champion``).
        created_ms: when it was registered, milliseconds since 1970.
        files: file name → content; filled by ``Registry.load`` alone, already checked against ``sha256``.
        decisions: whether it was to be promoted and why, oldest first.
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
        """``name@version``, the way a person and a lineage record name it."""
        return f"{self.name}@{self.version}"

    def to_json(self) -> dict[str, Any]:
        """Everything but the files' content."""
        return {
            "name": self.name,
            "version": self.version,
            "kind": self.kind,
            "digest": self.digest,
            "lineage": dict(self.lineage),
            "metrics": dict(self.metrics),
            "sha256": dict(self.sha256),
            "aliases": list(self.aliases),
            "created_ms": self.created_ms,
            "decisions": [decision.to_json() for decision in self.decisions],
        }


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def manifest(kind: str, hashes: Mapping[str, str], lineage: Mapping[str, Any], where: object) -> str:
    """Kind, lineage and file digests as canonical JSON; its sha256 is the version's digest.

    Raises:
        SettingsError: the lineage holds something that JSON cannot (NaN, an array, a path), or is too long to store.
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
    if len(text) > LARGEST_MANIFEST:
        raise SettingsError(
            f"{where}: lineage",
            f"{len(text)} characters of JSON",
            f"at most {LARGEST_MANIFEST}",
            "Put long tables into a JSON file of the model.",
        )
    return text


def check_alias(alias: str) -> str:
    """``alias`` unless it is no name or reads like a version number."""
    check_name(alias, "alias")
    if _VERSION.fullmatch(alias) or alias.lower() == "latest":
        raise SettingsError("alias", repr(alias), "a name that is neither a version number nor 'latest'", "Say e.g. champion.")
    return alias


def check_kind(kind: str) -> None:
    if kind not in KINDS:
        raise SettingsError("model kind", repr(kind), nearest(kind, KINDS))


def check_files(files: Mapping[str, bytes], where: object) -> None:
    """Refuse file names that are paths, and formats that can run code when they are read."""
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
    """The version that ``selector`` means: a number or an alias; for None the promoted one, or the newest where none is.

    Args:
        numbers: of all versions, at least one.
        aliases: alias → version; one that means a version that is no more is none.

    Raises:
        StoreError: there is none; lists what there is.
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
