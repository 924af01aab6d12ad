"""Model versions as items of the site."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime

from sysid.names import dotted
from sysid.registry import DamagedModel, ModelVersion
from sysid.registry.effect_changes import effect_value
from sysid.registry.figures import held_out_figures
from sysid.registry.lineage import sources
from sysid.reports.words import effect_title, signal_name
from sysid.site.item import Fact, Item

#: Lineage entries that are shown otherwise, or are digests of what another entry names.
_LEFT_OUT = ("dataset_digest", "effects")


def model_items(found: Sequence[ModelVersion | DamagedModel]) -> Iterator[Item]:
    """Every model version of a registry."""
    kinds = {entry.reference: entry.kind for entry in found if isinstance(entry, ModelVersion)}
    for entry in found:
        if isinstance(entry, DamagedModel):
            yield Item("damaged", entry.reference, damage=str(entry.error), summary=str(entry.error))
        else:
            yield _item(entry, kinds)


def _item(version: ModelVersion, kinds: Mapping[str, str]) -> Item:
    datasets, models = sources(version)
    parents = [f"dataset:{name}" for name in datasets if "@" in name]
    parents += [f"{kinds[name]}:{name}" for name in models if name in kinds and name != version.reference]
    return Item(
        version.kind,
        version.reference,
        created=f"{datetime.fromtimestamp(version.created_ms / 1e3, UTC):%Y-%m-%d %H:%M}",
        digest=version.digest,
        summary=_summary(version),
        aliases=version.aliases,
        parents=tuple(dict.fromkeys(parents)),
        facts=tuple(_facts(version)),
    )


def _summary(version: ModelVersion) -> str:
    effects = [f"{effect_title(item['name'])} ({item['target']})" for item in version.lineage.get("effects", ())]
    if version.kind == "plant":
        return ", ".join(effects) or "as machine.toml describes it"
    rows = [row for row in held_out_figures(version) if row.rows == "motion"] or held_out_figures(version)
    return f"held-out RMSE {signal_name(rows[0].signal)} {rows[0].rmse}" if rows else ""


def _facts(version: ModelVersion) -> Iterator[Fact]:
    yield Fact("Content", "kind", version.kind)
    yield Fact("Content", "aliases", ", ".join(version.aliases) or "none")
    for row in held_out_figures(version):
        yield Fact("Held-out RMSE", f"{signal_name(row.signal)}, {row.rows}", row.rmse)
    if not held_out_figures(version):
        for name, value in version.metrics.items():
            yield Fact("Figures", name, f"{value:.4g}")
    for effect in version.lineage.get("effects", ()):
        for name, value in effect.get("parameters", {}).items():
            text = effect_value(value, effect.get("units", {}).get(name, ""))
            yield Fact("Effects", f"{effect_title(effect['name'])}, {effect['target']}: {name.replace('_', ' ')}", text)
    for name, value in dotted({key: value for key, value in version.lineage.items() if key not in _LEFT_OUT}):
        text = ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
        yield Fact("Lineage and recipe", name, text)
    for name, digest in sorted(version.sha256.items()):
        yield Fact("Files, sha256", name, digest[:12])
