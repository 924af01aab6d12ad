"""Builds the site of a workspace, and again only the pages whose content has changed."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from sysid.datasets.versions.index import VersionIndex
from sysid.datasets.versions.manifest import Manifest
from sysid.errors import StorageError, StoreError, SysidError
from sysid.files import json_text
from sysid.gap.stored_result import load_gap
from sysid.machine import machine_from_files
from sysid.model_versions import ModelVersions
from sysid.parse import parse_json
from sysid.progress import Progress, silent
from sysid.registry import ModelVersion
from sysid.release import __version__
from sysid.reports.model_pages import card_page, models_page
from sysid.reports.pages import FOLDER as REPORTS
from sysid.reports.pages import SiteBar, write_page
from sysid.reports.report import build_report, plot_library
from sysid.root import Root
from sysid.site.inventory import inventory, read_flight
from sysid.site.item import Item
from sysid.site.lineage import around, drawing, lineage_graph
from sysid.site.pages import (
    PlantTraces,
    compare_page,
    dataset_page,
    flight_page,
    index_page,
    lineage_page,
    plant_traces,
    result_summary,
)
from sysid.workspace import Workspace

#: File of the site that states from what each page was made.
STAMPS = "pages.json"
LIBRARY = "plotly.js"


@dataclass(frozen=True)
class Built:
    """The result of a build.

    Args:
        index: the first page.
        made, kept: pages that were written, and that were up to date already.
        failed: page → why it could not be made; the others are complete.
    """

    index: Path
    made: tuple[str, ...]
    kept: tuple[str, ...]
    failed: Mapping[str, str]


def build_site(workspace: Workspace, folder: Path | None = None, progress: Progress = silent) -> Built:
    """Write the pages of a workspace, and remove those of items that are gone.

    Args:
        folder: of the site; default: ``site`` in the workspace.

    Raises:
        StoreError: a link in the folder.
        StorageError: it cannot be written.
    """
    root = Root(folder or workspace.root.make("site"))
    survey = workspace.models.survey()
    items = inventory(workspace, survey)
    before, stamps, made, failed = _stamps(root), {}, [], {}
    models = [entry for entry in survey if isinstance(entry, ModelVersion)]
    pages = list(_pages(workspace, items, models))
    for number, (path, content, make) in enumerate(pages):
        progress(number / len(pages), path)
        stamp = _stamp(content)
        if before.get(path) == stamp and root.kind(path) == "file":
            stamps[path] = stamp
            continue
        try:
            write_page(root.output(path), make())
        except StorageError:
            raise
        except SysidError as error:
            failed[path] = str(error)
            continue
        made.append(path)
        stamps[path] = stamp
    for path in before.keys() - stamps.keys() - failed.keys():
        root.remove(path)
    write_page(root.output(STAMPS), json_text({"schema": 1, "pages": stamps}))
    progress(1.0, "index.html")
    return Built(root.folder / "index.html", tuple(made), tuple(path for path in stamps if path not in made), failed)


#: Path of a page, everything that its content depends on, and the function that makes it.
Page = tuple[str, Any, Callable[[], str]]


def _pages(workspace: Workspace, items: Sequence[Item], models: Sequence[ModelVersion]) -> Iterator[Page]:
    by_key = {item.key: item for item in items if item.kind != "damaged"}
    graph = lineage_graph(by_key.values())
    yield LIBRARY, "", plot_library
    for item in by_key.values():
        if item.kind == "logs":
            continue
        near = around(graph, item.key)
        context = [asdict(by_key[key]) for key in sorted(near)]
        versioned = [other for other in by_key.values() if "@" in other.reference]
        others = [other for other in versioned if (other.kind, other.name) == (item.kind, item.name)]
        bar = site_bar(item, others)
        drawn = drawing(near, by_key, "../", item.key)
        yield item.path, [context, [other.key for other in others]], partial(_page, workspace, item, by_key, bar, drawn)
    cards = {item.reference: item.href for item in by_key.values() if item.path.startswith("models/")}
    name, everything = _title(workspace), [asdict(item) for item in items]
    created = f"{datetime.now().astimezone():%d %B %Y, %H:%M}".lstrip("0")
    yield "models.html", everything, lambda: models_page(models, name, cards=cards, bar=SiteBar())
    yield "lineage.html", everything, lambda: lineage_page(items, name)
    yield "compare.html", everything, lambda: compare_page(items, name, list(_traces(workspace, items)))
    yield "index.html", everything, lambda: index_page(items, name, created, _newest_result(workspace, items))


def _traces(workspace: Workspace, items: Sequence[Item]) -> Iterator[PlantTraces]:
    """A picture for each gap result with two stored plants; a result that cannot be read has its own message."""
    keys = {item.key for item in items}
    for item in items:
        if item.kind != "gap" or not {f"plant:{error.reference}" for error in item.errors} <= keys:
            continue
        with contextlib.suppress(StoreError):
            gap = load_gap(workspace.root.path(f"results/{item.reference}/gap"))
            found = plant_traces(gap, _manifest(workspace, item)["units"]) if gap is not None else None
            if found is not None:
                yield found


def _newest_result(workspace: Workspace, items: Sequence[Item]) -> Markup | None:
    """Verdict, drawing and errors of the newest gap result that can be read; None without one."""
    for item in items:
        if item.kind == "gap":
            with contextlib.suppress(StoreError):
                manifest, gap = _manifest(workspace, item), load_gap(workspace.root.path(f"results/{item.reference}/gap"))
                if gap is not None:
                    machine = machine_from_files(manifest["machine"], item.reference)
                    return result_summary(item, gap, machine, manifest["units"])
    return None


def _manifest(workspace: Workspace, item: Item) -> Manifest:
    name, _, version = item.reference.rpartition("@")
    return VersionIndex(workspace.location).read_manifest(name, int(version))


def site_bar(item: Item, others: Sequence[Item]) -> SiteBar:
    """The links of an item's page: other versions of it, and the comparison with the one before."""
    rows = sorted(others, key=lambda other: _number(other.reference))
    earlier = [other for other in rows if _number(other.reference) < _number(item.reference)]
    compare = f"compare.html#a={quote(earlier[-1].key)}&b={quote(item.key)}" if earlier else ""
    versions = tuple((f"@{_number(other.reference)}", other.href) for other in rows if other.key != item.key)
    return SiteBar("../", (item.word, item.reference), versions, compare)


def _page(workspace: Workspace, item: Item, by_key: Mapping[str, Item], bar: SiteBar, drawn: Markup) -> str:
    """The page of an item."""
    if item.kind == "dataset":
        gap = by_key.get(f"gap:{item.reference}")
        report = f"../{gap.href}" if gap is not None else ""
        recordings = workspace.dataset(item.reference).recordings
        return dataset_page(item, _manifest(workspace, item), recordings, bar, drawn, report)
    if item.kind == "gap":
        inputs = workspace.report_inputs(workspace.dataset(item.reference))
        return build_report(inputs, bar, drawn, f"../{LIBRARY}")
    if item.kind == "flight":
        return flight_page(item, read_flight(workspace.root, item.reference), bar, drawn)
    return card_page(ModelVersions(workspace).card(item.reference), bar, drawn)


def _title(workspace: Workspace) -> str:
    location = str(workspace.location)
    return location if "://" in location else Path(location).resolve().name


def _number(reference: str) -> int:
    return int(reference.rpartition("@")[2])


def _stamps(root: Root) -> dict[str, str]:
    """The stamps of the last build; none if their file is missing or damaged."""
    try:
        found = parse_json(root.read(STAMPS))["pages"]
        return {str(path): str(stamp) for path, stamp in found.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _stamp(content: Any) -> str:
    text = json.dumps([_TEMPLATES, content], sort_keys=True, default=str)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _template_digest() -> str:
    """Of everything that pages are made with: this release, its templates, styles and scripts."""
    digest = hashlib.sha256(__version__.encode())
    for folder in (REPORTS, Path(__file__).parent):
        for path in sorted(folder.rglob("*")):
            if path.suffix in (".html", ".css", ".js", ".py"):
                digest.update(path.read_bytes())
    return digest.hexdigest()


_TEMPLATES = _template_digest()
