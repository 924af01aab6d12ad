"""What a workspace holds, as items with their sources: dataset versions and their raw files, from manifests alone; stored gap
results; model versions; and runs of a machine, from the records that its runs leave in the workspace.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from sysid.datasets.versions.index import VersionIndex
from sysid.datasets.versions.manifest import Manifest, clock_from
from sysid.display import NOTHING, fixed, minute, number, quantity, size_text
from sysid.errors import SettingsError, StoreError
from sysid.figures import ParameterFigure, stored_errors, stored_parameters
from sysid.gap.result import Gap
from sysid.gap.stored_result import RESULT
from sysid.names import dotted
from sysid.parse import parse_json
from sysid.registry import DamagedModel, ModelVersion
from sysid.registry.version import sources
from sysid.reports.dataset_texts import ROLES, clock_text, length_text, role_text
from sysid.reports.result_figures import point_errors
from sysid.reports.words import effect_title, signal_name
from sysid.root import Root
from sysid.site.item import Fact, HeldOutError, Item
from sysid.workspace import Workspace

#: Group of the facts that give each signal's SI unit.
SIGNALS = "Signals"


def dataset_items(index: VersionIndex, flights: Mapping[str, str]) -> Iterator[Item]:
    """Every dataset version, and the raw files of those that were ingested.

    Args:
        flights: sha256 of a flight log → key of its run.
    """
    for entry, manifest in index.survey():
        if manifest is None:
            yield Item("damaged", entry.reference, damage=entry.damage)
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
    return Item(
        "logs",
        _reference(manifest),
        digest=digest,
        summary=f"{len(sources)} raw file{'s' * (len(sources) > 1)}, {size_text(sum(source['size'] for source in sources))}",
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
        facts=tuple(_dataset_facts(manifest)),
    )


def _dataset_facts(manifest: Manifest) -> Iterator[Fact]:
    roles = Counter(ROLES[role] for role in manifest["splits"].values())
    yield Fact("Content", "machine", manifest["machine_name"])
    yield Fact("Content", "recordings", str(len(manifest["recordings"])))
    yield Fact("Content", "roles", ", ".join(f"{count} {role}" for role, count in roles.items()) or "none")
    yield Fact("Content", "raw files", str(len(manifest["sources"])))
    flags = manifest["quality"].get("flags", [])
    yield Fact("Content", "flagged sections", str(len(flags)))
    for item in manifest["recordings"]:
        role = role_text(item["kind"], manifest["splits"].get(item["name"]))
        length = length_text(item["kind"], item["rows"], item["rate_hz"])
        yield Fact("Recordings", item["name"], f"{length}, {role}, {len(item['signals'])} signals")
    for signal, unit in manifest["units"].items():
        yield Fact(SIGNALS, signal, unit)
    for clock in map(clock_from, manifest["clocks"]):
        yield Fact("Clocks", f"{clock.recording}, {clock.stream}", clock_text(clock))


def _reference(manifest: Manifest) -> str:
    return f"{manifest['name']}@{manifest['version']}"


def gap_items(root: Root, units: Mapping[str, Mapping[str, str]]) -> Iterator[Item]:
    """Every stored gap result.

    Args:
        root: of the workspace.
        units: dataset version → its signals' SI units.
    """
    for reference, kind in root.entries("results").items():
        path = f"results/{reference}/gap/{RESULT}"
        if kind != "folder" or reference.startswith(".") or root.kind(f"results/{reference}/gap") != "folder":
            continue
        try:
            content = root.read(path)
            changed = (root.folder / path).stat().st_mtime
            yield _gap(parse_json(content), reference, content, changed, units.get(reference, {}))
        except FileNotFoundError:
            continue
        except (OSError, ValueError, KeyError, TypeError, AttributeError, StoreError, SettingsError) as error:
            yield Item("damaged", reference, damage=f"gap result of {reference}: {error}")


def _gap(values: dict[str, Any], reference: str, content: bytes, changed: float, units: Mapping[str, str]) -> Item:
    before, after = values["plant"]["before"], values["plant"]["after"]
    effects = [f"{effect_title(item['name'], item['target'])} ({item['target']})" for item in values["effects"]]
    found = values["headline"].rstrip(".")
    return Item(
        "gap",
        reference,
        created=minute(1e3 * changed),
        digest=hashlib.sha256(content).hexdigest(),
        summary=f"{found}: {', '.join(effects)}" if effects else found,
        parents=tuple([f"dataset:{reference}"] + ([f"plant:{before}"] if "@" in before else [])),
        facts=tuple(_gap_facts(values, units)),
        errors=tuple(_gap_errors(values, reference, units)),
        created_plant=after if after != before else "",
    )


def _gap_errors(values: dict[str, Any], reference: str, units: Mapping[str, str]) -> Iterator[HeldOutError]:
    """Held-out errors of the plant before and of the one after, points as distances."""
    known = {key: {name: v for name, v in own.items() if v is not None} for key, own in values["gap"].items()}
    where = f"{reference}: {', '.join(values.get('held_out_recordings', ()))}"
    for figure in point_errors(Gap(known["before"], known["after"], known["noise_floor"]), units):
        for plant, value in ((values["plant"]["before"], figure.before), (values["plant"]["after"], figure.after)):
            floor = figure.noise_floor if figure.noise_floor > 0.0 else None
            yield HeldOutError(plant, where, figure.name, figure.unit, value, floor)


def _gap_facts(values: dict[str, Any], units: Mapping[str, str]) -> Iterator[Fact]:
    yield Fact("Result", "verdict", values["verdict"])
    yield Fact("Result", "plant before", values["plant"]["before"])
    yield Fact("Result", "plant after", values["plant"]["after"])
    for effect in values["effects"]:
        yield from _parameters(effect)
    for item in values["unnamed"]:
        yield Fact("Unnamed", f"{item['stage']} stage of {item['target']}", f"depends on {item['depends_on']}; {item['form']}")
    for when in ("before", "after"):
        for signal, value in values["gap"][when].items():
            if value is not None:
                yield Fact(f"Held-out RMSE {when}", signal_name(signal), quantity(value, units.get(signal)))


def _parameters(effect: Mapping[str, Any]) -> Iterator[Fact]:
    for place, figure in _figures(effect):
        ends = figure.interval
        yield Fact("Effects", place, figure.text if ends == NOTHING else f"{figure.text} ({ends})")


def _figures(effect: Mapping[str, Any]) -> Iterator[tuple[str, ParameterFigure]]:
    for figure in stored_parameters(effect):
        yield f"{effect_title(effect['name'])}, {effect['target']}: {figure.label}", figure


#: Lineage entries that are shown otherwise, or are digests of what another entry names.
_LEFT_OUT = ("dataset_digest", "effects", "proof")


def model_items(found: Sequence[ModelVersion | DamagedModel]) -> Iterator[Item]:
    """Every model version of a registry."""
    kinds = {entry.reference: entry.kind for entry in found if isinstance(entry, ModelVersion)}
    for entry in found:
        if isinstance(entry, DamagedModel):
            yield Item("damaged", entry.reference, damage=str(entry.error))
        else:
            yield _model(entry, kinds)


def _model(version: ModelVersion, kinds: Mapping[str, str]) -> Item:
    datasets, models = sources(version)
    parents = [f"dataset:{name}" for name in datasets if "@" in name]
    parents += [f"{kinds[name]}:{name}" for name in models if name in kinds and name != version.reference]
    return Item(
        version.kind,
        version.reference,
        created=minute(version.created_ms),
        digest=version.digest,
        summary=_summary(version),
        aliases=version.aliases,
        parents=tuple(dict.fromkeys(parents)),
        facts=tuple(_model_facts(version)),
        errors=tuple(_stored_errors(version)),
        parameters=tuple(pair for effect in version.lineage.get("effects", ()) for pair in _figures(effect)),
    )


def _stored_errors(version: ModelVersion) -> Iterator[HeldOutError]:
    where = str(version.lineage.get("dataset", ""))
    for error in stored_errors(version.metrics):
        yield HeldOutError(version.reference, where, f"{signal_name(error.output)}, {error.rows}", error.unit, error.rmse)


def _summary(version: ModelVersion) -> str:
    effects = [f"{effect_title(item['name'])} ({item['target']})" for item in version.lineage.get("effects", ())]
    if version.kind == "plant":
        return ", ".join(effects) or "as machine.toml describes it"
    errors = sorted(stored_errors(version.metrics), key=lambda error: error.rows != "motion")
    return f"held-out RMSE {signal_name(errors[0].output)} {errors[0].texts[0]}" if errors else ""


def _model_facts(version: ModelVersion) -> Iterator[Fact]:
    yield Fact("Content", "kind", version.kind)
    yield Fact("Content", "aliases", ", ".join(version.aliases) or "none")
    errors = stored_errors(version.metrics)
    for error in errors:
        yield Fact("Held-out RMSE", f"{signal_name(error.output)}, {error.rows}", error.texts[0])
    if not errors:
        for name, value in version.metrics.items():
            yield Fact("Figures", name, f"{value:.4g}")
    for effect in version.lineage.get("effects", ()):
        yield from _parameters(effect)
    for name, value in dotted({key: value for key, value in version.lineage.items() if key not in _LEFT_OUT}):
        values = value if isinstance(value, list | tuple) else [value]
        text = ", ".join(number(v, 4) if isinstance(v, float) else str(v) for v in values)
        yield Fact("Lineage and recipe", name, text)
    for name, digest in sorted(version.sha256.items()):
        yield Fact("Files, sha256", name, digest[:12])


#: Folder of the records in a workspace: a JSON file of schema 1 a run.
FOLDER = "flights"
NOT_ENDED = "not ended: the run goes on, or it was killed"


def flight_items(root: Root, models: Mapping[str, Item]) -> Iterator[Item]:
    """Every recorded run.

    Args:
        root: of the workspace.
        models: reference → model version, for the sources of a run.
    """
    for name, kind in root.entries(FOLDER).items():
        if kind != "file" or name.startswith(".") or not name.endswith(".json"):
            continue
        reference = name.removesuffix(".json")
        try:
            yield _flight(read_flight(root, reference), reference, models)
        except (OSError, ValueError, KeyError, TypeError, AttributeError, StoreError) as error:
            yield Item("damaged", reference, damage=f"record of the run {reference}: {type(error).__name__}: {error}")


def read_flight(root: Root, reference: str) -> dict[str, Any]:
    """The record of a run.

    Raises:
        OSError, ValueError, StoreError: it cannot be read.
    """
    return dict(parse_json(root.read(f"{FOLDER}/{reference}.json")))


def _flight(values: Mapping[str, Any], reference: str, models: Mapping[str, Item]) -> Item:
    used = [models[name] for name, digest in values["versions"].items() if name in models and models[name].digest == digest]
    return Item(
        "flight",
        reference,
        created=values["started"][:16].replace("T", " "),
        digest=values["sha256"],
        summary=f"{values['name']}: {values['mode']} on {values['machine']}; {_result(values)}",
        parents=tuple(item.key for item in used),
        facts=tuple(_flight_facts(values)),
    )


def _result(values: Mapping[str, Any]) -> str:
    parts = [ended(values)]
    if values.get("distance_mm"):
        parts.append(f"tracking error RMSE {fixed(values['distance_mm']['rmse'], 2)} mm")
    if values.get("verdicts"):
        parts.append(f"violated: {', '.join(values['verdicts'])}")
    return "; ".join(parts)


def ended(values: Mapping[str, Any]) -> str:
    """How a run ended, as the console states it."""
    if values["ended"] is None:
        return NOT_ENDED
    return f"ended: {values['ended']}, state {values['state']}" + (f", {values['why']}" if values["why"] else "")


def _flight_facts(values: Mapping[str, Any]) -> Iterator[Fact]:
    yield Fact("Content", "recipe", values["name"])
    yield Fact("Content", "mode", values["mode"])
    yield Fact("Content", "machine", values["machine"])
    yield Fact("Content", "transport", values["transport"])
    yield Fact("Result", "ended", ended(values))
    if values["ended"] is None:
        return
    yield Fact("Result", "cycles", str(values["turns"]))
    yield Fact("Result", "deadlines missed", str(values["missed_deadlines"]))
    for norm, value in (values["distance_mm"] or {}).items():
        yield Fact("Tracking error, distance", norm, f"{fixed(value, 2)} mm")
    for title, key in (("RMSE", "rmse_mm"), ("largest", "max_mm")):
        for axis, value in zip("xyz", values[key] or (), strict=False):
            yield Fact(f"Tracking error, {title}", axis, f"{fixed(value, 2)} mm")
    for check, count in values["verdicts"].items():
        yield Fact("Violations", check, f"{count} cycles")
    for title, key in (("lateness", "lateness_us"), ("time of a cycle", "turn_us")):
        for quantile, value in values[key].items():
            if value is not None:
                yield Fact("Timing", f"{title}, {quantile}", f"{fixed(value, 0)} µs")
    for name, digest in values["versions"].items():
        yield Fact("Versions", name, digest[:12])


def inventory(workspace: Workspace, survey: Sequence[ModelVersion | DamagedModel] | None = None) -> tuple[Item, ...]:
    """All items of a workspace, the newest first; no table and no network is loaded.

    What cannot be read is an item of the kind ``damaged``.

    Args:
        survey: of the registry; default: made here.
    """
    survey = workspace.models.survey() if survey is None else survey
    models = list(model_items(survey))
    flights = list(flight_items(workspace.root, {item.reference: item for item in models if item.kind != "damaged"}))
    logs = {item.digest: item.key for item in flights if item.digest}
    datasets = list(dataset_items(VersionIndex(workspace.location), logs))
    units = {item.reference: {f.name: f.text for f in item.facts if f.group == SIGNALS} for item in datasets}
    found = [*datasets, *gap_items(workspace.root, units), *models, *flights]
    items = {item.key: item for item in found if item.kind != "damaged"}
    for gap in [item for item in items.values() if item.kind == "gap"]:
        for reference in dict.fromkeys(error.reference for error in gap.errors):
            plant = items.get(f"plant:{reference}")
            if plant is not None:
                own = tuple(error for error in gap.errors if error.reference == reference)
                items[plant.key] = replace(plant, errors=plant.errors + own)
        plant = items.get(f"plant:{gap.created_plant}")
        if plant is not None:
            items[plant.key] = replace(plant, parents=(*plant.parents, gap.key))
    whole = [replace(item, parents=tuple(key for key in item.parents if key in items)) for item in items.values()]
    return tuple(sorted(whole, key=lambda item: item.created, reverse=True)) + tuple(
        item for item in found if item.kind == "damaged"
    )
