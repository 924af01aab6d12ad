"""Self-contained HTML pages from templates and style sheets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from sysid.files import written_whole
from sysid.reports import display, words

FOLDER = Path(__file__).parent


def filled(template: str, **values: Any) -> Markup:
    """A template of this package with its values; values other than markup are escaped."""
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
    return Markup(environment.get_template(template).render(**values))


def page(template: str, styles: Sequence[str], **values: Any) -> str:
    """A whole page: a template that extends ``shell.html``, with inline style sheets."""
    style = "\n".join((FOLDER / name).read_text("utf-8") for name in styles)
    return str(filled(template, style=Markup(style), **values))


def write_page(path: Path, text: str) -> Path:
    """Write a page atomically; missing folders are created."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as half:
        half.write_text(text, "utf-8")
    return path
