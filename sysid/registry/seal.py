"""Seals: digests of what the manifest of a version does not cover (figures, decisions, time, aliases).

A seal is updated in the transaction that changes what it covers. It has no key: it detects changes by hand or by another
program, but not a forged seal.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace

from pydantic import ConfigDict, TypeAdapter
from typing_extensions import TypedDict

from sysid.errors import StoreError
from sysid.parse import parse_json
from sysid.registry.stored import DECISION, DIGEST, METRICS, SEAL, ModelChange, StoredModel, StoredVersion

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


def is_sealed(model: StoredModel) -> bool:
    """False for a model of an earlier release without seals."""
    return SEAL in model.tags or any(SEAL in version.tags for version in model.own)


def broken_version(model: StoredModel, version: StoredVersion) -> StoreError | None:
    """The error if a version does not match its seal; None if it does, or has none from an earlier release."""
    unsealed = SEAL not in version.tags and SEAL not in model.tags
    if unsealed or version.tags.get(SEAL) == version_seal(model.name, version):
        return None
    return StoreError(
        f"{model.name}@{version.number}",
        "its figures or decisions were changed by hand",
        "the row as sysid wrote it",
        REMEDY,
    )


def broken_model(model: StoredModel) -> StoreError | None:
    """The error if a model's aliases or list of versions do not match its seal; None if they do."""
    if not is_sealed(model) or model.tags.get(SEAL) == model_seal(model):
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
    if aliases and not is_sealed(model):
        concerned |= {version.number for version in after.own}
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
