"""The documentation as a site: ``make docs``."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import runpy
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).parents[2]
faults = runpy.run_path(str(ROOT / "docs" / "site" / "check.py"))["faults"]
mathml = runpy.run_path(str(ROOT / "docs" / "site" / "formula.py"))["mathml"]


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
    ],
)
def test_a_formula_is_mathml(text: str, element: str) -> None:
    assert mathml(text) == f'<div class="formula"><math display="block"><mrow>{element}</mrow></math></div>'


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_and_without_dead_links(tmp_path: Path) -> None:
    if importlib.util.find_spec("mkdocs") is None:
        pytest.skip("mkdocs is not installed: make docs installs it")
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    index = (tmp_path / "search" / "search_index.js").read_text("utf-8")  # read where the site lies on a disk
    found = {entry["location"] for entry in json.loads(index.removeprefix("var __index = "))["docs"]}
    assert "guide/servo.html" in found
    assert {place for place in found if place.startswith(("reports/", "decisions/"))} == set()
    pages = sorted(tmp_path.rglob("*.html"))
    assert "<mi>T</mi>" in (tmp_path / "effects" / "first_order_lag.html").read_text("utf-8")
    wanted = {"reference/sysid.gap.html", "machines/autolog.html", "effects/gallery.html", "notebooks/first-look.html"}
    assert {"index.html", *wanted} <= {page.relative_to(tmp_path).as_posix() for page in pages}
    for page in pages:
        text = page.read_text("utf-8")
        assert not re.search(r"<(?:link|script|img)[^>]+(?:src|href)=.https?:", text), f"{page.name} loads from elsewhere"
        for target in Links(text).targets if page.name != "404.html" else ():
            path = unquote(target.partition("#")[0].partition("?")[0])
            if path and ":" not in path and not path.startswith("/"):
                assert (page.parent / path).exists(), f"{page.relative_to(tmp_path)}: {target}"
