"""Names, versions, aliases and decisions as an MLflow registry holds them, read into frozen values and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ConfigDict, TypeAdapter
from typing_extensions import TypedDict

from sysid.errors import SettingsError, StoreError
from sysid.names import check_name
from sysid.parse import parse_json
from sysid.registry.artifacts import checked
from sysid.registry.promotion import Decision
from sysid.registry.version import CHAMPION, Kind, ModelVersion, check_files, sha256

#: Tags of an MLflow version. One tag a decision: nothing that was decided is ever rewritten.
DIGEST, MANIFEST, METRICS, DECISION = "sysid.digest", "sysid.manifest", "sysid.metrics", "sysid.decision"
#: What the champion was called in registries of before.
FORMER = "promoted"

_PAGE = 1000


class _Content(TypedDict):
    """The manifest of a version."""

    __pydantic_config__ = ConfigDict(strict=True)  # type: ignore[misc]

    kind: Kind
    lineage: dict[str, Any]
    files: dict[str, str]


_CONTENT = TypeAdapter(_Content)
_METRICS = TypeAdapter(dict[str, float])


def model_names(client: Any) -> list[str]:
    """Every registered model, sorted."""
    names: list[str] = []
    token = None
    while True:
        page = client.search_registered_models(max_results=_PAGE, page_token=token)
        names += [model.name for model in page]
        token = page.token
        if not token:
            return sorted(names)


@dataclass(frozen=True)
class DamagedVersion:
    """A row that cannot be read, and why: changed by hand, damaged, or made by somebody else.

    Args:
        version: 0 where the model itself cannot be read.
    """

    name: str
    version: int
    damage: str
    aliases: tuple[str, ...] = ()

    @property
    def reference(self) -> str:
        return f"{self.name}@{self.version}"


def entries(client: Any, name: str) -> tuple[list[tuple[ModelVersion, str]], list[DamagedVersion]]:
    """Of each version of ``name`` that sysid registered, oldest first, (version, source URI); and what cannot be read."""
    try:
        check_name(name)
    except SettingsError as error:
        return [], [DamagedVersion(name, 0, str(error))]
    own: list[Any] = []
    token = None
    while True:
        page = client.search_model_versions(f"name='{name}'", max_results=_PAGE, page_token=token)
        own += [entry for entry in page if DIGEST in entry.tags and MANIFEST in entry.tags]
        token = page.token
        if not token:
            break
    # The search leaves out aliases (mlflow/mlflow#16734).
    aliases = dict(client.get_registered_model(name).aliases) if own else {}
    if FORMER in aliases:
        aliases.setdefault(CHAMPION, aliases.pop(FORMER))
    found, damaged = [], []
    for entry in own:
        try:
            found.append((_version(entry, aliases), str(entry.source)))
        except StoreError as error:
            damaged.append(DamagedVersion(name, int(entry.version), str(error), _aliases_of(int(entry.version), aliases)))
    return sorted(found, key=lambda entry: entry[0].version), damaged


def decision_key(decision: Decision) -> str:
    """A tag of its own for every decision; in the order of time."""
    return f"{DECISION}.{decision.decided_ms:013d}-{sha256(decision.to_text().encode('utf-8'))[:6]}"


def _version(entry: Any, aliases: Mapping[str, Any]) -> ModelVersion:
    """One MLflow entry as a frozen value; its manifest must hash to its digest."""
    text, digest, number = entry.tags[MANIFEST], entry.tags[DIGEST], int(entry.version)
    where = f"{entry.name}@{number}"
    checked(text.encode("utf-8"), digest, f"{where}: manifest")
    try:
        content = _CONTENT.validate_python(parse_json(text))
        kind, lineage, files = content["kind"], content["lineage"], content["files"]
        metrics = _METRICS.validate_python(parse_json(entry.tags.get(METRICS, "{}")))
        check_files(dict.fromkeys(files, b""), where)  # a foreign registry may name paths
    except (ValueError, KeyError, TypeError, SettingsError) as error:
        found = f"not one of ours ({type(error).__name__}: {error})"
        raise StoreError(f"{where}: manifest", found, "what sysid registered", "Was it made by another program?") from None
    decisions = sorted((key, value) for key, value in entry.tags.items() if key.startswith(f"{DECISION}."))
    return ModelVersion(
        name=entry.name,
        version=number,
        kind=kind,
        digest=digest,
        lineage=lineage,
        metrics=metrics,
        sha256=files,
        aliases=_aliases_of(number, aliases),
        created_ms=int(entry.creation_timestamp),
        decisions=tuple(Decision.from_text(value, f"{where}: {key}") for key, value in decisions),
    )


def _aliases_of(number: int, aliases: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(sorted(alias for alias, target in aliases.items() if int(target) == number))
