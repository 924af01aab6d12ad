"""Builds the report: one self-contained page of sections."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from sysid.figures import Table
from sysid.reports.inputs import ReportInputs
from sysid.reports.pages import FOLDER, SiteBar, filled, page, write_page
from sysid.reports.sections import (
    excitation,
    networks,
    proof,
    quality,
    responses,
    summary,
    traces,
    where,
)

Context = dict[str, Any]


@dataclass(frozen=True)
class Section:
    """``context`` gives the values of the template ``sections/<name>.html``; None leaves the section out."""

    name: str
    title: str
    context: Callable[[ReportInputs], Context | None]


#: Keys of a lineage with what a version was made from.
SOURCES = ("dataset", "plant", "networks")


def _versions(inputs: ReportInputs) -> Context:
    """Versions and their sources, settings and software of the figures."""
    gap, dataset = inputs.gap, inputs.dataset
    own = [(dataset.reference, "dataset", "", dataset.digest, f"{len(dataset.sources)} raw files")]
    for version in inputs.versions:
        parents = ", ".join(str(version.lineage[key]) for key in SOURCES if version.lineage.get(key))
        own.append((version.reference, version.kind, parents, version.digest, ", ".join(version.aliases)))
    name, content = Markup('<b class="nowrap">{}</b>'), Markup("<code>{}</code>")
    rows = [(name.format(text), *kind, content.format(digest[:12]), note) for text, *kind, digest, note in own]
    return {
        "figures": Table(("Version", "Kind", "Made from", "Content", ""), rows),
        "software": dict(inputs.software),
        "settings": {key: str(value) for key, value in (gap.settings if gap is not None else {}).items()},
        "notes": gap.notes if gap is not None else (),
    }


#: In the order of the page: result, proof, details, data.
SECTIONS: tuple[Section, ...] = (
    Section("summary", "In short", summary.context),
    Section("where", "Where they disagree", where.context),
    Section("responses", "Without a model", responses.context),
    Section("traces", "Before and after", traces.context),
    Section("proof", "The proof", proof.context),
    Section("parameters", "What was added", proof.parameters),
    Section("evidence", "Candidates and evidence", proof.candidates),
    Section("experiments", "What to record next", excitation.experiments),
    Section("networks", "Networks", networks.context),
    Section("excitation", "Excitation", excitation.context),
    Section("quality", "The recordings", quality.context),
    Section("clocks", "The clocks", quality.clocks),
    Section("versions", "Versions", _versions),
)


def build_report(inputs: ReportInputs, bar: SiteBar | None = None, lineage: Markup | None = None, library: str = "") -> str:
    """The whole page as HTML text, with styles, script, plot library and data, without external content.

    Args:
        bar, lineage: as for :func:`sysid.reports.model_pages.card_page`.
        library: path of the plot library (:func:`plot_library`) that the pages of a site share; empty to include it.
    """
    sections = []
    for section in SECTIONS:
        context = section.context(inputs)
        if context is not None:
            body = filled(f"sections/{section.name}.html", **context)
            sections.append({"name": section.name, "title": section.title, "body": body})
    return page(
        "page.html",
        ("page.css",),
        kind="Simulation against machine",
        title=inputs.dataset.machine.name,
        inputs=inputs,
        sections=sections,
        script=Markup("\n".join((FOLDER / name).read_text("utf-8") for name in ("page.js", "replay.js"))),
        plotly="" if library else Markup(plot_library()),
        library=library,
        bar=bar,
        lineage=lineage,
    )


def write_report(path: Path, inputs: ReportInputs) -> Path:
    """Write the page to ``path`` atomically; missing folders are created."""
    return write_page(path, build_report(inputs))


@functools.cache
def plot_library() -> str:
    """The script of Plotly, such that it can be part of a page."""
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs()).replace("</script", "<\\/script")
