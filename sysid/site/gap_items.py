"""Stored gap results as items of the site."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

from sysid.display import interval, quantity
from sysid.errors import StoreError
from sysid.gap.statement import headline
from sysid.parse import parse_json
from sysid.reports.archive import RESULT
from sysid.reports.words import effect_title, signal_name
from sysid.root import Root
from sysid.site.item import Fact, Item


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
            yield _item(parse_json(content), reference, content, changed, units.get(reference, {}))
        except FileNotFoundError:
            continue
        except (OSError, ValueError, KeyError, TypeError, AttributeError, StoreError) as error:
            damage = f"gap result of {reference}: {error}"
            yield Item("damaged", reference, damage=damage, summary=damage)


def _item(values: dict[str, Any], reference: str, content: bytes, changed: float, units: Mapping[str, str]) -> Item:
    before, after = values["plant"]["before"], values["plant"]["after"]
    effects = [f"{effect_title(item['name'], item['target'])} ({item['target']})" for item in values["effects"]]
    found = (values.get("headline") or headline(values["verdict"], len(effects))).rstrip(".")
    return Item(
        "gap",
        reference,
        created=f"{datetime.fromtimestamp(changed, UTC):%Y-%m-%d %H:%M}",
        digest=hashlib.sha256(content).hexdigest(),
        summary=f"{found}: {', '.join(effects)}" if effects else found,
        parents=tuple([f"dataset:{reference}"] + ([f"plant:{before}"] if "@" in before else [])),
        facts=tuple(_facts(values, units)),
        created_plant=after if after != before else "",
    )


def _facts(values: dict[str, Any], units: Mapping[str, str]) -> Iterator[Fact]:
    yield Fact("Result", "verdict", values["verdict"])
    yield Fact("Result", "plant before", values["plant"]["before"])
    yield Fact("Result", "plant after", values["plant"]["after"])
    for effect in values["effects"]:
        where = f"{effect_title(effect['name'], effect['target'])}, {effect['target']}"
        for name, value in effect["parameters"].items():
            if value is None:
                continue
            unit = effect.get("units", {}).get(name)
            low, high = effect["interval95"].get(name) or (None, None)
            spread = f" ({interval(low, high, unit)})" if low is not None and high is not None else ""
            yield Fact("Effects", f"{where}: {name.replace('_', ' ')}", f"{quantity(value, unit)}{spread}")
    for item in values["unnamed"]:
        yield Fact("Unnamed", f"{item['stage']} stage of {item['target']}", f"depends on {item['depends_on']}; {item['form']}")
    for when in ("before", "after"):
        for signal, value in values["gap"][when].items():
            if value is not None:
                yield Fact(f"Held-out RMSE {when}", signal_name(signal), quantity(value, units.get(signal)))
