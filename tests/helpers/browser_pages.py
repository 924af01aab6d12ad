"""Pages in headless Chromium, and what axe-core finds on them."""

from __future__ import annotations

import importlib.util
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
#: Nothing may leave this computer.
OPTIONS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update", "--disable-sync"]
#: The script of axe-core; None where its package is not installed.
_PACKAGE = importlib.util.find_spec("axe_playwright_python")
AXE = None if _PACKAGE is None else Path(str(_PACKAGE.origin)).with_name("axe.min.js")
NO_AXE = "axe-core is not here: the package axe-playwright-python, of the extra `dev`"
_RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser of its own process."""
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)
        yield started
        started.close()


def findings(page: Page) -> list[tuple[str, str]]:
    """Rule of WCAG 2.1 A or AA and first place of each violation that axe-core finds on an open page."""
    page.add_script_tag(path=AXE)
    found = page.evaluate("rules => axe.run({runOnly: rules, resultTypes: ['violations']})", _RULES)
    return [(entry["id"], entry["nodes"][0]["html"][:120]) for entry in found["violations"]]
