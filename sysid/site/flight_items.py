"""Runs of a machine as items of the site, from the records that its runs leave in the workspace."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from sysid.display import fixed
from sysid.errors import StoreError
from sysid.parse import parse_json
from sysid.root import Root
from sysid.site.item import Fact, Item

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
            yield _item(read_flight(root, reference), reference, models)
        except (OSError, ValueError, KeyError, TypeError, AttributeError, StoreError) as error:
            damage = f"record of the run {reference}: {type(error).__name__}: {error}"
            yield Item("damaged", reference, damage=damage, summary=damage)


def read_flight(root: Root, reference: str) -> dict[str, Any]:
    """The record of a run.

    Raises:
        OSError, ValueError, StoreError: it cannot be read.
    """
    return dict(parse_json(root.read(f"{FOLDER}/{reference}.json")))


def _item(values: Mapping[str, Any], reference: str, models: Mapping[str, Item]) -> Item:
    used = [models[name] for name, digest in values["versions"].items() if name in models and models[name].digest == digest]
    return Item(
        "flight",
        reference,
        created=values["started"][:16].replace("T", " "),
        digest=values["sha256"],
        summary=f"{values['name']}: {values['mode']} on {values['machine']}; {_result(values)}",
        parents=tuple(item.key for item in used),
        facts=tuple(_facts(values)),
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


def _facts(values: Mapping[str, Any]) -> Iterator[Fact]:
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
