"""Reads stored rows into checked, frozen values, by their seals: digests of what the manifest of a version does not cover
(figures, decisions, time, aliases).

A seal is updated in the transaction that changes what it covers. It has no key: it detects changes by hand or by another
program, but not a forged seal.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pydantic import ConfigDict, TypeAdapter
from typing_extensions import TypedDict

from sysid.errors import SettingsError, StoreError
from sysid.names import check_name
from sysid.parse import parse_json
from sysid.registry.artifacts import checked
from sysid.registry.promotion import PromotionDecision
from sysid.registry.stored import DECISION, DIGEST, LATEST_MS, MANIFEST, METRICS, SEAL, ModelChange, StoredModel, StoredVersion
from sysid.registry.version import Kind, ModelVersion, check_files, sha256

REMEDY = "`sysid models repair` restores what it can."


class _Sealed(TypedDict):
    """The readable part of a model's seal, beside its sha256."""

    __pydantic_config__ = ConfigDict(strict=True)  # type: ignore[misc]

    aliases: dict[str, int]
    count: int


_SEALED = TypeAdapter(_Sealed)


def version_seal(name: str, version: StoredVersion) -> str:
    """sha256 over name, digest, figures and decisions. The model's seal covers number and time, which a server assigns."""
    decisions = sorted((key, value) for key, value in version.tags.items() if key.startswith(f"{DECISION}."))
    figures = version.tags.get(METRICS, "{}")
    return _sha([name, version.tags[DIGEST], figures, decisions])


def model_seal(model: StoredModel) -> str:
    """The aliases, the number of versions, and a sha256 over both and the seals of all versions, as JSON."""
    own = model.own
    aliases = dict(sorted(model.aliases.items()))
    covered = [model.name, aliases, [[version.number, version.created_ms, version.tags.get(SEAL, "")] for version in own]]
    return json.dumps({"aliases": aliases, "count": len(own), "sha256": _sha(covered)}, sort_keys=True)


def broken_version(model: StoredModel, version: StoredVersion) -> StoreError | None:
    """The error if a version does not match its seal; None if it does."""
    if version.tags.get(SEAL) == version_seal(model.name, version):
        return None
    return StoreError(
        f"{model.name}@{version.number}",
        "its figures or decisions were changed by hand",
        "the row as sysid wrote it",
        REMEDY,
    )


def broken_model(model: StoredModel) -> StoreError | None:
    """The error if a model's aliases or list of versions do not match its seal; None if they do."""
    registered = bool(model.own) or SEAL in model.tags
    if not registered or model.tags.get(SEAL) == model_seal(model):
        return None
    where, sealed, count = f"model {model.name}", sealed_aliases(model), len(model.own)
    if sealed is None:
        return StoreError(where, "the seal of its aliases is missing or damaged", "the row as sysid wrote it", REMEDY)
    recorded = parse_json(model.tags[SEAL])["count"]
    if dict(model.aliases) != sealed:
        found, expected = _aliases_text(model.aliases), _aliases_text(sealed)
        return StoreError(where, f"its aliases were changed by hand ({found})", expected, REMEDY)
    if recorded != count:
        return StoreError(where, f"{count} versions", f"the {recorded} that were registered", REMEDY)
    return StoreError(where, "rows of its versions were changed or exchanged", "the rows as sysid wrote them", REMEDY)


def sealed_aliases(model: StoredModel) -> dict[str, int] | None:
    """The sealed aliases; None if they cannot be read."""
    try:
        return _SEALED.validate_python(parse_json(model.tags[SEAL]))["aliases"]
    except (KeyError, ValueError):
        return None


def sealed(model: StoredModel, change: ModelChange, aliases: bool) -> ModelChange:
    """``change`` with the new seals of ``model``.

    Args:
        aliases: also seal the model as a whole.
    """
    after = changed(model, change)
    concerned = {*change.version_tags, *([change.new.number] if change.new else [])}
    tags = {number: dict(values) for number, values in change.version_tags.items()}
    new = change.new
    for version in after.own:
        if version.number in concerned:
            seal = version_seal(model.name, version)
            if new is not None and version.number == new.number:
                new = replace(new, tags={**new.tags, SEAL: seal})
            else:
                tags.setdefault(version.number, {})[SEAL] = seal
    found = replace(change, new=new, version_tags=tags)
    return replace(found, tags={**change.tags, SEAL: model_seal(changed(model, found))}) if aliases else found


def changed(model: StoredModel, change: ModelChange) -> StoredModel:
    """``model`` after ``change``."""
    versions = (*model.versions, *([change.new] if change.new is not None else []))
    given = {alias: number for alias, number in {**model.aliases, **change.aliases}.items() if number is not None}
    return StoredModel(
        model.name,
        tuple(replace(v, tags=_merged(v.tags, change.version_tags.get(v.number, {}))) for v in versions),
        given,
        {**model.tags, **change.tags},
        max(model.last, change.new.number if change.new is not None else 0),
    )


def _merged(tags: Mapping[str, str], more: Mapping[str, str | None]) -> dict[str, str]:
    return {key: value for key, value in {**tags, **more}.items() if value is not None}


def _aliases_text(aliases: Mapping[str, int]) -> str:
    return ", ".join(f"{alias} is version {number}" for alias, number in sorted(aliases.items())) or "no alias"


def _sha(value: object) -> str:
    return hashlib.sha256(json.dumps(value, separators=(",", ":")).encode("utf-8")).hexdigest()


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
