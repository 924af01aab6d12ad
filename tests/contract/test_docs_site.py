"""The documentation as a site: ``make docs``."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import runpy
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Literal
from urllib.parse import unquote

import pytest
from browser_pages import AXE, CHROMIUM, NO_AXE, chromium, findings
from playwright.sync_api import Browser
from playwright.sync_api import Error as BrowserError

ROOT = Path(__file__).parents[2]
faults = runpy.run_path(str(ROOT / "docs" / "site" / "check.py"))["faults"]
formula = runpy.run_path(str(ROOT / "docs" / "site" / "formula.py"))


class Links(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.targets += [value for key, value in attrs if key in ("href", "src") and value]


@pytest.mark.parametrize(
    ("html", "markdown", "fault"),
    [
        ("<p>```sh slow sysid gap arm</p>", "", "a fence that begins no block: ```sh slow sysid gap arm"),
        ("<pre><code>sysid gap\n```\n</code></pre>", "", "a fence that begins no block: ```"),
        ("<p>| a | b |\n| --- | --- |</p>", "", "a row of no table: | a | b |"),
        ("<td><code>\\|x\\|</code></td>", "", "an escaped bar: \\|x\\|"),
        ("<h1>A</h1><pre>## B</pre>", "# A\n\n## B\n", "1 of 2 headings are text or code"),
    ],
)
def test_markdown_that_is_not_rendered_is_a_fault(html: str, markdown: str, fault: str) -> None:
    """``make docs`` ends at such a page."""
    assert fault in faults(html, markdown)


def test_what_is_rendered_has_no_fault() -> None:
    markdown = "# A\n\n```sh\n# a comment\n```\n\n| a | b |\n| --- | --- |\n| `x` | 1 |\n"
    html = "<h1>A</h1><pre><code># a comment\n| a | b |\n</code></pre><table><td><code>|x|</code></td></table>"
    assert faults(html, markdown) == []


@pytest.mark.parametrize(
    ("text", "element"),
    [
        ("ẋ", "<mover><mi>x</mi><mo>˙</mo></mover>"),
        ("T²", "<msup><mi>T</mi><mn>2</mn></msup>"),
        ("10⁻⁶", "<msup><mn>10</mn><mn>−6</mn></msup>"),
        ("ω₀", "<msub><mi>ω</mi><mn>0</mn></msub>"),
        ("R_last", "<msub><mi>R</mi><mtext>last</mtext></msub>"),
        (
            "e^(−(a)/b)c",
            "<msup><mi>e</mi><mrow><mo>−</mo><mo>(</mo><mi>a</mi><mo>)</mo><mo>/</mo><mi>b</mi></mrow></msup><mi>c</mi>",
        ),
        ("0.5<x", "<mn>0.5</mn><mo>&lt;</mo><mi>x</mi>"),
        ("time_constant", "<mtext>time_constant</mtext>"),
        ("√(2p)", "<msqrt><mn>2</mn><mi>p</mi></msqrt>"),
    ],
)
def test_a_formula_is_mathml(text: str, element: str) -> None:
    assert formula["inline"](text) == f"<math><mrow>{element}</mrow></math>"
    assert formula["mathml"](text) == f'<div class="formula"><math display="block"><mrow>{element}</mrow></math></div>'


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the built site; its build ends at a warning."""
    if importlib.util.find_spec("mkdocs") is None:
        pytest.skip("mkdocs is not installed: make docs installs it")
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


def searched(site: Path) -> dict[str, int]:
    """Page that the search holds → number of its words."""
    index = (site / "search" / "search_index.js").read_text("utf-8")  # read where the site lies on a disk
    found: dict[str, int] = {}
    for entry in json.loads(index.removeprefix("var __index = "))["docs"]:
        page = entry["location"].partition("#")[0]
        found[page] = found.get(page, 0) + len(re.sub("<[^>]+>", " ", entry["text"]).split())
    return found


@pytest.mark.slow
def test_the_pages_are_short(site: Path) -> None:
    """Of all pages in the search, those of machines included; the reference is made from docstrings."""
    words = searched(site)
    assert "guide/servo.html" in words
    assert {page for page in words if page.startswith(("reports/", "decisions/"))} == set()
    assert 20_000 < sum(count for page, count in words.items() if not page.startswith("reference/")) <= 45_000


@pytest.mark.slow
def test_the_site_has_no_dead_link_and_loads_nothing_from_elsewhere(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert "<mi>T</mi>" in (site / "effects" / "first_order_lag.html").read_text("utf-8")
    assert "over <math><mrow><msqrt><mn>12</mn></msqrt></mrow></math>" in (site / "guide/servo.html").read_text("utf-8")
    wanted = {"reference/sysid.gap.html", "machines/autolog.html", "effects/gallery.html", "notebooks/first-look.html"}
    assert {"index.html", *wanted} <= {page.relative_to(site).as_posix() for page in pages}
    for page in pages:
        text = page.read_text("utf-8")
        assert not re.search(r"<(?:link|script|img)[^>]+(?:src|href)=.https?:", text), f"{page.name} loads from elsewhere"
        for target in Links(text).targets if page.name != "404.html" else ():
            path = unquote(target.partition("#")[0].partition("?")[0])
            if path and ":" not in path and not path.startswith("/"):
                assert (page.parent / path).exists(), f"{page.relative_to(site)}: {target}"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed")
    with chromium() as started:
        yield started


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_page_is_wider_than_its_window(site: Path, browser: Browser, scheme: Literal["light", "dark"]) -> None:
    wide = []
    page = browser.new_page(color_scheme=scheme)
    for path in sorted(site.rglob("*.html")):
        page.goto(path.as_uri())
        for width in (360, 768, 1280):
            page.set_viewport_size({"width": width, "height": 900})
            try:  # the theme wraps wide tables once a page is loaded
                page.wait_for_function("document.documentElement.scrollWidth <= innerWidth", timeout=2000)
            except BrowserError:
                wide.append(f"{path.relative_to(site)} at {width} px")
    page.close()
    assert wide == []


#: A page of each kind: text and code, tables, formulas, pictures, a notebook, docstrings.
KINDS = ("index", "install", "guide/export", "guide/mujoco", "effects/backlash", "effects/gallery", "notebooks/first-look")
KINDS = (*KINDS, "reference/sysid_rl.control", "glossary")


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.skipif(AXE is None, reason=NO_AXE)
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [360, 1280])
def test_axe_finds_nothing_on_a_page_of_each_kind(
    site: Path, browser: Browser, width: int, scheme: Literal["light", "dark"]
) -> None:
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    found = {}
    for name in KINDS:
        page.goto((site / f"{name}.html").as_uri())
        found[name] = findings(page)
    page.close()
    assert found == {name: [] for name in KINDS}
