"""Reads stored rows into checked, frozen values."""

from __future__ import annotations

from typing import Any

from pydantic import ConfigDict, TypeAdapter
from typing_extensions import TypedDict

from sysid.errors import SettingsError, StoreError
from sysid.names import check_name
from sysid.parse import parse_json
from sysid.registry.artifacts import checked
from sysid.registry.decision import PromotionDecision
from sysid.registry.seal import REMEDY, broken_version
from sysid.registry.stored import DECISION, DIGEST, LATEST_MS, MANIFEST, METRICS, StoredModel, StoredVersion
from sysid.registry.version import Kind, ModelVersion, check_files, sha256


class _Manifest(TypedDict):
    """The manifest of a version."""

    __pydantic_config__ = ConfigDict(strict=True)  # type: ignore[misc]

    kind: Kind
    lineage: dict[str, Any]
    files: dict[str, str]


_MANIFEST = TypeAdapter(_Manifest)
_METRICS = TypeAdapter(dict[str, float])


def check_stored_name(model: StoredModel) -> None:
    """Refuse a name that is not safe in paths, queries and references.

    Raises:
        StoreError: the message states the rules.
    """
    try:
        check_name(model.name)
    except SettingsError as error:
        raise StoreError(error.where, error.found, error.expected, "Was it made by another program?") from None


def version_of(model: StoredModel, entry: StoredVersion) -> ModelVersion:
    """One version, checked against its digest and its seal.

    Raises:
        StoreError: the manifest, the figures or a decision were changed.
    """
    text, digest = entry.tags[MANIFEST], entry.tags[DIGEST]
    where = f"{model.name}@{entry.number}"
    if entry.number < 1 or not 0 <= entry.created_ms <= LATEST_MS:
        found = f"number {entry.number}, made {entry.created_ms} ms after 1970"
        raise StoreError(where, found, "a number from 1 on and a date", REMEDY)
    checked(text.encode("utf-8", "surrogatepass"), digest, f"{where}: manifest")
    try:
        content = _MANIFEST.validate_python(parse_json(text))
        kind, lineage, files = content["kind"], content["lineage"], content["files"]
        check_files(dict.fromkeys(files, b""), where)  # another program may have registered paths
    except (ValueError, KeyError, TypeError, SettingsError) as error:
        found = f"not a manifest of sysid ({type(error).__name__}: {error})"
        raise StoreError(f"{where}: manifest", found, "what sysid registered", "Was it made by another program?") from None
    keys = sorted(key for key in entry.tags if key.startswith(f"{DECISION}."))
    decisions = tuple(PromotionDecision.from_text(entry.tags[key], f"{where}: {key}") for key in keys)
    metrics = _metrics(entry.tags.get(METRICS, "{}"), where)
    broken = broken_version(model, entry)
    if broken is not None:
        raise broken
    return ModelVersion(
        name=model.name,
        version=entry.number,
        kind=kind,
        digest=digest,
        lineage=lineage,
        metrics=metrics,
        sha256=files,
        aliases=tuple(sorted(alias for alias, target in model.aliases.items() if target == entry.number)),
        created_ms=entry.created_ms,
        decisions=decisions,
    )


def kind_of(model: StoredModel) -> str | None:
    """The common kind of all versions of a model; None if it has none."""
    return version_of(model, model.own[0]).kind if model.own else None


def decision_key(decision: PromotionDecision) -> str:
    """The tag of a decision; tags are in the order of time."""
    return f"{DECISION}.{decision.decided_ms:013d}-{sha256(decision.to_text().encode('utf-8'))[:6]}"


def _metrics(text: str, where: str) -> dict[str, float]:
    try:
        return _METRICS.validate_python(parse_json(text))
    except (ValueError, TypeError) as error:
        found = f"not figures ({type(error).__name__}: {error})"
        raise StoreError(f"{where}: {METRICS}", found, "what sysid registered", "Remove that tag in the registry.") from None
