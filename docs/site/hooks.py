"""Pages and links of the documentation site (``mkdocs.yml``).

The Markdown files are written to be read in the repository. Here those outside of ``docs/`` become pages, links between them
are mapped, other files that they name are copied, the reference is made from the docstrings of the public packages, and
notebooks become pages of their texts, code and outputs. A page with Markdown that was not rendered ends the build.
"""

from __future__ import annotations

import json
import posixpath
import re
from pathlib import Path
from typing import Any

from check import faults
from formula import inline, mathml
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
#: Packages of the reference: module → what it is for.
PACKAGES = {
    "sysid.front.gap": "what `sysid.find_gap` returns",
    "sysid.workspace": "datasets, models and results of one folder",
    "sysid.datasets": "ingest logs, store and load dataset versions",
    "sysid.machine": "the description of a machine",
    "sysid.networks": "fit networks",
    "sysid.validate": "evaluate networks on held-out recordings",
    "sysid.plant": "the simulation of a machine",
    "sysid.effects": "named effects",
    "sysid.gap": "find and name what the simulation lacks",
    "sysid.registry": "model versions, aliases, decisions",
    "sysid.model_versions": "promote, compare, export and document model versions",
    "sysid.reports": "the report of a dataset version",
    "sysid.site": "a workspace as linked pages",
    "sysid.view": "Rerun recordings",
    "sysid.testing": "check an effect of your own",
    "sysid_rl.control": "controllers of cylinders and of hanging tools",
    "sysid_rl.train": "train and track policies",
    "sysid_rl.run": "run a machine, supervised and recorded",
}
#: Pages that the search leaves out: how figures and decisions came about; what other pages say.
UNSEARCHED = ("reports", "decisions/", "changelog", "effects/gallery")
#: A link or picture: the target without spaces or title, an anchor apart.
LINK = re.compile(r"(\]\()([^)\s#]+)((?:#[^)\s]*)?\))")
#: A colour of a terminal.
ANSI = re.compile(r"\x1b\[[0-9;]*m")
#: A picture for a dark page.
SOURCE = re.compile(r'(srcset=")([^"]+)(")')
#: A role of a docstring in HTML.
ROLE = re.compile(r":(?:attr|class|data|exc|func|meth|mod):(<code[^>]*>)~?")
#: A block of formulas.
FORMULA = re.compile(r"^```formula\n(.*?)\n```$", re.MULTILINE | re.DOTALL)
#: A formula inside a sentence, as GitHub has it too.
INLINE = re.compile(r"\$`([^`\n]+)`\$")
#: The first line of a block of code with more than its language, at any depth.
FENCE = re.compile(r"^( *```+\w+) .*$", re.MULTILINE)
#: A block of code with text on the line after it, which is no paragraph in HTML without a line between them.
JOINED = re.compile(r"^( *)(```+)\w.*?^\1\2$(?=\n *\S)", re.MULTILINE | re.DOTALL)
#: A cell of a table: in its code too, a bar is written with a backslash.
CELL = re.compile(r"<td.*?</td>", re.DOTALL)
#: Blocks and spans of code, in which brackets are no links.
CODE = re.compile(r"(```.*?```|`[^`\n]*`)", re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages outside of ``docs/``, and the reference."""
    for path, page in pages().items():
        if path.endswith(".ipynb"):
            files.append(File.generated(config, page, content=notebook_page(ROOT / path)))
        elif not path.startswith("docs/"):
            files.append(File.generated(config, page, content=(ROOT / path).read_text("utf-8")))
    for path in sorted(linked() - pages().keys()):
        files.append(File.generated(config, f"files/{path}", abs_src_path=str(ROOT / path)))
    rows = [f"| [`{name}`]({name}.md) | {what} |" for name, what in PACKAGES.items()]
    index = ["# Python", "", "This page lists the public packages.", "", "| package | for |", "| --- | --- |", *rows, ""]
    files.append(File.generated(config, "reference/index.md", content="\n".join(index)))
    for name in PACKAGES:
        files.append(File.generated(config, f"reference/{name}.md", content=f"# {name}\n\n::: {name}\n"))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Map the links of a page to the places in the site, draw formulas, and leave of a block of code its language.

    What follows the language is for the tests that run the pages; the site takes such a block for text.
    """
    markdown = FORMULA.sub(lambda match: mathml(match[1]), markdown)
    markdown = INLINE.sub(lambda match: inline(match[1]), markdown)
    markdown = JOINED.sub(r"\g<0>\n", FENCE.sub(r"\1", markdown))
    if page.file.src_uri.startswith(UNSEARCHED):
        page.meta["search"] = {"exclude": True}
    source = next((path for path, name in pages().items() if name == page.file.src_uri), "")
    if not source:
        return markdown
    place = page.file.src_uri
    parts = CODE.split(markdown)

    def moved(match: re.Match[str]) -> str:
        return match[1] + mapped(match[2], source, place) + match[3]

    parts[::2] = [SOURCE.sub(moved, LINK.sub(moved, part)) for part in parts[::2]]
    return "".join(parts)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Roles of docstrings (``:class:`~sysid.gap.GapResult```) as plain code; bars of tables as GitHub shows them.

    Raises:
        PluginError: Markdown of the page was not rendered.
    """
    if page.file.src_uri.startswith("reference/"):
        return ROLE.sub(r"\1", html)
    html = CELL.sub(lambda match: match[0].replace(r"\|", "|"), html)
    if found := faults(html, page.markdown or ""):
        raise PluginError(f"{page.file.src_uri}: " + "; ".join(found))
    return html


def mapped(target: str, source: str, page: str) -> str:
    """The target of a link in ``source`` (path in the repository), relative to ``page`` (path in the site)."""
    path = resolved(target, source)
    if path is None:
        return target
    place = pages().get(path, path.removeprefix("docs/") if path.startswith("docs/") else f"files/{path}")
    return posixpath.relpath(place, posixpath.dirname(page) or ".")


def resolved(target: str, source: str) -> str | None:
    """The file of the repository that a link means; None for an address or a missing file."""
    if ":" in target:
        return None
    path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
    if (ROOT / path).is_dir():
        path = posixpath.join(path, "README.md")
    return path if (ROOT / path).is_file() else None


def pages() -> dict[str, str]:
    """Path of a page in the repository → its place in the site."""
    found = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "pipelines/README.md": "pipelines.md"}
    found |= {"reports/README.md": "reports.md", "rl/README.md": "rl.md", "datasets/README.md": "machines/index.md"}
    for path in sorted((ROOT / "datasets").glob("*/README.md")):
        found[path.relative_to(ROOT).as_posix()] = f"machines/{path.parent.name}.md"
    for path in sorted((ROOT / "reports").glob("*/README.md")):
        found[path.relative_to(ROOT).as_posix()] = f"reports/{path.parent.name}.md"
    for path in sorted([*(ROOT / "docs").rglob("*.md"), *(ROOT / "docs").rglob("*.ipynb")]):
        found[path.relative_to(ROOT).as_posix()] = path.relative_to(ROOT / "docs").with_suffix(".md").as_posix()
    return found


def notebook_page(path: Path) -> str:
    """The cells of a notebook and their stored outputs as Markdown."""
    parts = []
    for cell in json.loads(path.read_text("utf-8"))["cells"]:
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
        parts += [output_block(output) for output in cell.get("outputs", ())]
    return "\n\n".join([*parts, f"[Download this notebook]({path.name})", ""])


def output_block(output: dict[str, Any]) -> str:
    """One output of a cell: its richest form that needs no script."""
    data = {kind: "".join(text) for kind, text in output.get("data", {}).items() if isinstance(text, str | list)}
    for kind in ("image/svg+xml", "text/html"):
        if kind in data and "<script" not in data[kind]:
            text = data[kind].replace(' border="1" class="dataframe"', "")  # a table as those of the other pages
            return "<div>\n" + re.sub(r"\n\s*\n", "\n", text) + "\n</div>"
    if "image/png" in data:
        return f'<img alt="output of the cell above" src="data:image/png;base64,{data["image/png"].replace(chr(10), "")}">'
    text = "".join(output.get("text", ())) or data.get("text/plain", "") or "\n".join(output.get("traceback", ()))
    return f"```text\n{ANSI.sub('', text).rstrip()}\n```" if text.strip() else ""


def linked() -> set[str]:
    """Files outside of ``docs/`` that a page links."""
    found = set()
    for source in pages():
        text = notebook_page(ROOT / source) if source.endswith(".ipynb") else (ROOT / source).read_text("utf-8")
        for part in CODE.split(text)[::2]:
            targets = (resolved(match[2], source) for match in LINK.finditer(part))
            found |= {path for path in targets if path is not None and not path.startswith("docs/")}
    return found
