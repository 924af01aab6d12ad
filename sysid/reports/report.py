"""Puts the sections together into one page that loads nothing from anywhere."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from sysid.files import written_whole
from sysid.reports import display, words
from sysid.reports.inputs import ReportInputs
from sysid.reports.sections import (
    clocks,
    evidence,
    experiments,
    networks,
    parameters,
    proof,
    quality,
    readiness,
    summary,
    traces,
    versions,
    where,
)

Context = dict[str, Any]


@dataclass(frozen=True)
class Section:
    """``context`` gives the values of the template ``sections/<name>.html``; None leaves the section out."""

    name: str
    title: str
    context: Callable[[ReportInputs], Context | None]


#: In the order of reading: the answer, its proof, its details, and what everything rests on.
SECTIONS: tuple[Section, ...] = (
    Section("summary", "In short", summary.context),
    Section("where", "Where they disagree", where.context),
    Section("traces", "Before and after", traces.context),
    Section("proof", "The proof", proof.context),
    Section("parameters", "What was added", parameters.context),
    Section("evidence", "Candidates and evidence", evidence.context),
    Section("experiments", "What to record next", experiments.context),
    Section("networks", "Networks", networks.context),
    Section("readiness", "Excitation", readiness.context),
    Section("quality", "The recordings", quality.context),
    Section("clocks", "The clocks", clocks.context),
    Section("versions", "Versions", versions.context),
)


def build_report(inputs: ReportInputs) -> str:
    """The whole page as HTML text: styles, script, plot library and data inside, no address outside."""
    environment = _environment()
    sections = []
    for section in SECTIONS:
        context = section.context(inputs)
        if context is not None:
            body = environment.get_template(f"sections/{section.name}.html").render(context)
            sections.append({"name": section.name, "title": section.title, "body": Markup(body)})
    folder = Path(__file__).parent
    return environment.get_template("page.html").render(
        inputs=inputs,
        sections=sections,
        style=Markup((folder / "page.css").read_text("utf-8")),
        script=Markup((folder / "page.js").read_text("utf-8")),
        plotly=_plotly(),
    )


def write_report(path: Path, inputs: ReportInputs) -> Path:
    """Write the page to ``path``, whole or not at all; folders are made as needed."""
    text = build_report(inputs)
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as half:
        half.write_text(text, "utf-8")
    return path


@functools.cache
def _plotly() -> Markup:
    from plotly.offline import get_plotlyjs

    return Markup(get_plotlyjs().replace("</script", "<\\/script"))


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("sysid.reports", ""),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "number": display.number,
        "fixed": display.fixed,
        "percent": display.percent,
        "ratio": display.ratio,
        "owner": words.owner_name,
        "stage": words.stage_name,
        "effect": words.effect_title,
    }
    return environment
