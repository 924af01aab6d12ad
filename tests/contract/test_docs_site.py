"""The documentation as a site: ``make docs``."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).parents[2]


class Links(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.targets += [value for key, value in attrs if key in ("href", "src") and value]


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
    pages = sorted(tmp_path.rglob("*.html"))
    wanted = {"reference/sysid.gap.html", "machines/autolog.html", "effects/gallery.html", "notebooks/first-look.html"}
    assert {"index.html", *wanted} <= {page.relative_to(tmp_path).as_posix() for page in pages}
    for page in pages:
        text = page.read_text("utf-8")
        assert "```" not in text, f"{page.name}: a block of code that the site does not take for one"
        assert not re.search(r"<(?:link|script|img)[^>]+(?:src|href)=.https?:", text), f"{page.name} loads from elsewhere"
        for target in Links(text).targets if page.name != "404.html" else ():
            path = unquote(target.partition("#")[0].partition("?")[0])
            if path and ":" not in path and not path.startswith("/"):
                assert (page.parent / path).exists(), f"{page.relative_to(tmp_path)}: {target}"
