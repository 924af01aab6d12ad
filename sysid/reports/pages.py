"""Self-contained HTML pages from templates and style sheets."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from sysid import display
from sysid.files import written_whole
from sysid.reports import words

FOLDER = Path(__file__).parent
#: Styles of pages that are part of a site.
LINKED = "linked.css"


@dataclass(frozen=True)
class SiteBar:
    """Links from a page to the other pages of the site that it is part of.

    Args:
        up: path from the page to the root of the site: empty, or ``../``.
        trail: kind and name of what the page shows; empty on the pages of the whole workspace.
        versions: other versions of the same name: text and path from the root.
        compare: path from the root to the comparison with the version before; empty without one.
    """

    up: str = ""
    trail: tuple[str, ...] = ()
    versions: tuple[tuple[str, str], ...] = ()
    compare: str = ""


def filled(template: str, folder: Path = FOLDER, **values: Any) -> Markup:
    """A template with its values; values other than markup are escaped.

    Args:
        folder: of the template; templates that it extends or includes may be of this package.
    """
    return Markup(_environment(folder).get_template(template).render(**values))


@functools.cache
def _environment(folder: Path) -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([folder, FOLDER]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "fixed": display.fixed,
        "percent": display.percent,
        "mark": {"passed": "✓", "failed": "✗", "left out": "–"}.get,
        "owner": words.owner_name,
        "table": lambda table, look="numbers": filled("table.html", table=table, look=look),
    }
    return environment


def page(template: str, styles: Sequence[str], folder: Path = FOLDER, bar: SiteBar | None = None, **values: Any) -> str:
    """A whole page: a template that extends ``shell.html``, with inline style sheets of this package or of ``folder``."""
    names = [*styles, *([LINKED] if bar is not None else [])]
    style = "\n".join(next(f for f in (folder / name, FOLDER / name) if f.is_file()).read_text("utf-8") for name in names)
    return str(filled(template, folder, style=Markup(style), bar=bar, **values))


def write_page(path: Path, text: str) -> Path:
    """Write a page atomically; missing folders are created."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as half:
        half.write_text(text, "utf-8")
    return path
