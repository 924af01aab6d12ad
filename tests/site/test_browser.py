"""The site in a browser: search, sorting, comparison, lineage, phone, keyboard, and what axe-core finds.

Needs Chromium (Debian's package ``chromium``).
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser_pages import AXE, CHROMIUM, NO_AXE, chromium, findings
from playwright.sync_api import Browser, Page
from run_records import keep_run
from sample_workspace import sample_workspace

from sysid.site import build_site

PAGES = ("index.html", "lineage.html", "compare.html", "models.html", "datasets/autolog@1.html", "reports/autolog@1.html")
PAGES = (*PAGES, "models/autolog@2.html", "models/autolog-actuator@1.html", "flights/motion-20260503T141500.html")

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("browser")
    place = sample_workspace(folder / "ws")
    keep_run(place, folder / "logs")
    return build_site(place).index.parent


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as started:
        yield started


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page on which an error or a message of the console fails the test."""
    context = browser.new_context(viewport={"width": 1400, "height": 900})
    opened = context.new_page()
    messages: list[str] = []
    opened.on("console", lambda message: messages.append(message.text))
    opened.on("pageerror", lambda error: messages.append(str(error)))
    yield opened
    context.close()
    assert messages == []


def rows(page: Page) -> list[str]:
    """Kind and name of the visible rows of the overview."""
    return [str(row.get_attribute("data-key")) for row in page.locator("#table tbody tr:visible").all()]


def test_search_and_kinds_filter_the_table(site: Path, page: Page) -> None:
    page.goto((site / "index.html").as_uri())
    assert len(rows(page)) == 8
    page.get_by_label("Search").fill("backlash slew")
    assert set(rows(page)) == {"gap:autolog@1", "plant:autolog@2"}
    page.get_by_role("button", name="plant 2").click()
    assert rows(page) == ["plant:autolog@2"]
    page.get_by_label("Search").fill("nothing has this")
    assert rows(page) == []
    assert page.get_by_text("Nothing matches.").is_visible()


def test_columns_sort_both_ways(site: Path, page: Page) -> None:
    page.goto((site / "index.html").as_uri())
    header = page.get_by_role("button", name="name")
    header.click()
    names = [cell.inner_text().split()[0] for cell in page.locator("#table tbody td:nth-child(2)").all()]
    assert names == sorted(names)
    assert page.locator("th", has=header).get_attribute("aria-sort") == "ascending"
    header.click()
    again = [cell.inner_text().split()[0] for cell in page.locator("#table tbody td:nth-child(2)").all()]
    assert again == names[::-1] or sorted(again, reverse=True) == again


def test_two_rows_are_compared(site: Path, page: Page) -> None:
    page.goto((site / "index.html").as_uri())
    page.get_by_label("compare plant autolog@1").check()
    page.get_by_label("compare plant autolog@2").check()
    page.get_by_role("link", name="Compare them").click()
    assert page.locator("#head-a").inner_text() == "plant autolog@1"
    assert page.locator("#head-b").inner_text() == "plant autolog@2"
    assert page.locator("#all").get_attribute("open") is None, "all properties are folded"
    page.locator("#result").click()
    differing = page.locator("#compared tbody tr", has_text="Backlash, slew: width")
    assert differing.locator("td").nth(1).inner_text() == "–"
    assert float(differing.locator("td").nth(2).inner_text()) == pytest.approx(0.01052, rel=0.01)
    assert page.locator("#compared tbody tr", has_text="machine.toml").count() == 0
    page.get_by_label("differences only").uncheck()
    assert page.locator("#compared tbody tr", has_text="plant.json").count() == 1
    page.reload()
    assert page.locator("#head-b").inner_text() == "plant autolog@2", "the choice is part of the address"


def test_the_newest_two_plants_are_compared_as_pictures(site: Path, page: Page) -> None:
    page.goto((site / "compare.html").as_uri())
    assert [page.locator(f"#head-{side}").inner_text() for side in "ab"] == ["plant autolog@1", "plant autolog@2"]
    row = page.locator("#errors li", has_text="tool position")
    stored = json.loads((site.parent / "results/autolog@1/gap/result.json").read_text())["gap"]
    distances = [math.hypot(*(stored[when][f"tool.{axis}"] for axis in "xyz")) for when in ("before", "after")]
    texts = [float(value) for value in re.findall(r"[\d.]+", row.locator("small").inner_text())]
    assert texts == pytest.approx([1e3 * value for value in distances], rel=6e-3)
    places = [float(str(row.locator(f"i.{look}").get_attribute("style")).split()[1][:-2]) for look in ("before", "after")]
    decades = math.log10(distances[0] / distances[1])
    assert places[0] - places[1] > 20.0 * decades, "three decades to the left, on a logarithmic scale"
    assert page.locator("figure.trace:visible path.before").count() == 1
    width = page.locator("#parameters li", has_text="Backlash, slew: width")
    assert width.locator("i.after").count() == 1
    assert width.locator("i.before").count() == 0, "the nominal plant has none"
    page.locator("#b").select_option("dataset:autolog@1")
    assert page.locator("figure.trace:visible").count() == 0
    assert page.locator("#errors").is_hidden()


def test_the_lineage_is_walked_by_clicks_and_by_keys(site: Path, page: Page) -> None:
    page.goto((site / "lineage.html").as_uri())
    page.locator("a.gap").click()
    assert page.url.endswith("reports/autolog%401.html")
    page.locator("#lineage a.champion").click()
    assert page.locator("h1").inner_text() == "autolog@2"
    page.locator("#drawn a.dataset").first.focus()
    page.keyboard.press("Enter")
    page.wait_for_url("**/datasets/autolog%401.html")
    page.get_by_role("link", name="Workspace").click()
    assert page.locator("#table").is_visible()


def test_a_run_is_found_by_its_fault_and_leads_to_its_plant(site: Path, page: Page) -> None:
    page.goto((site / "index.html").as_uri())
    page.get_by_label("Search").fill("fault ms old")
    assert rows(page) == ["flight:motion-20260503T141500"]
    page.locator("#table").get_by_role("link", name="motion-20260503T141500").click()
    assert page.locator("#events tr.refused").count() == 2
    page.locator("#lineage a.champion").click()
    assert page.locator("h1").inner_text() == "autolog@2"


def test_versions_lead_to_the_comparison_with_the_one_before(site: Path, page: Page) -> None:
    page.goto((site / "models/autolog-actuator@2.html").as_uri())
    page.get_by_role("link", name="compare with the version before").click()
    assert page.locator("#head-a").inner_text() == "actuator networks autolog-actuator@1"


def test_the_report_draws_its_figures_and_saves_them(site: Path, page: Page) -> None:
    page.goto((site / "reports/autolog@1.html").as_uri())
    page.locator("#traces-figure").scroll_into_view_if_needed()
    page.locator("#traces-figure .main-svg").first.wait_for()
    with page.expect_download() as download:
        page.get_by_role("button", name="Save as CSV").click()
    lines = Path(download.value.path()).read_text().splitlines()
    assert lines[0].startswith("time [s],")
    assert lines[0].count(",") == lines[100].count(",")
    assert page.locator("nav a[aria-current]").inner_text() == "Before and after"


def test_the_replay_moves_stops_and_turns(site: Path, page: Page) -> None:
    page.goto((site / "reports/autolog@1.html").as_uri())
    canvas, label = page.locator("#replay"), page.locator("#replay-label")
    canvas.scroll_into_view_if_needed()
    first = label.inner_text()
    page.wait_for_function("text => document.getElementById('replay-label').textContent !== text", arg=first)
    page.get_by_role("button", name="Stop").click()
    still = page.evaluate("document.getElementById('replay').toDataURL()")
    canvas.focus()
    page.keyboard.press("ArrowLeft")
    assert page.evaluate("document.getElementById('replay').toDataURL()") != still
    page.locator("#replay-time").fill("0")
    assert label.inner_text() != first or first.startswith("0.0")
    assert "tool before" in label.inner_text()


@pytest.mark.slow
def test_a_reader_who_wants_no_motion_gets_a_still_picture(browser: Browser, site: Path) -> None:
    context = browser.new_context(reduced_motion="reduce")
    page = context.new_page()
    page.goto((site / "reports/autolog@1.html").as_uri())
    page.locator("#replay").scroll_into_view_if_needed()
    page.wait_for_timeout(300)
    assert page.locator("#replay-time").input_value() == "0"
    assert page.get_by_role("button", name="Play").is_visible()
    context.close()


#: Right edges of figures that reach beyond the window, and texts of pictures that are cut at it.
CUT = """() => [...document.querySelectorAll("figure, svg.chart, svg.machine, .dumbbells, .heat td, .answer")]
  .filter((e) => !(e.matches("svg") && e.closest(".scroll")) && e.checkVisibility() && e.getBoundingClientRect().width > 0)
  .filter((e) => e.getBoundingClientRect().right > innerWidth + 0.5
    || (e.matches("figure") && e.scrollWidth > e.clientWidth + 1))
  .map((e) => e.outerHTML.slice(0, 120))"""


@pytest.mark.parametrize("width", [360, pytest.param(390, marks=pytest.mark.slow)])
@pytest.mark.parametrize("path", PAGES)
def test_no_page_and_no_figure_is_wider_than_a_phone(browser: Browser, site: Path, path: str, width: int) -> None:
    context = browser.new_context(viewport={"width": width, "height": 800})
    page = context.new_page()
    page.goto((site / path).as_uri())
    found, cut = page.evaluate("document.documentElement.scrollWidth"), page.evaluate(CUT)
    context.close()
    assert found == width
    assert cut == []


@pytest.mark.parametrize(("width", "height"), [pytest.param(1400, 900, marks=pytest.mark.slow), (390, 844)])
def test_the_first_screen_says_what_was_wrong_by_how_much_and_what_next(
    browser: Browser, site: Path, width: int, height: int
) -> None:
    context = browser.new_context(viewport={"width": width, "height": height})
    page = context.new_page()
    page.goto((site / "reports/autolog@1.html").as_uri())
    answers = page.locator("#summary .answer")
    ends = {box.locator("h3").inner_text(): box.bounding_box() for box in answers.all()}
    context.close()
    assert list(ends) == ["What was wrong", "By how much", "What next"]
    assert all(box is not None and box["y"] + box["height"] <= height for box in ends.values())


@pytest.mark.slow
def test_paper_has_what_is_unfolded_with_its_colours(browser: Browser, site: Path) -> None:
    context = browser.new_context()
    page = context.new_page()
    page.goto((site / "reports/autolog@1.html").as_uri())
    pages = re.findall(rb"/Type\s*/Page\b", page.pdf(prefer_css_page_size=True))
    page.emulate_media(media="print")
    folded, colours = page.locator("details:not([open])").first, "e => getComputedStyle(e).printColorAdjust"
    assert not folded.is_visible()
    assert page.locator(".heat td").first.evaluate(colours) == "exact"
    context.close()
    assert 0 < len(pages) <= 10


@pytest.mark.slow
def test_figures_that_were_never_in_view_are_printed(browser: Browser, site: Path) -> None:
    context = browser.new_context()
    page = context.new_page()
    page.goto((site / "reports/autolog@1.html").as_uri())
    unfolded = (
        "[...document.querySelectorAll('[data-figure], #traces-figure')].filter((e) => !e.closest('details:not([open])'))"
    )
    count = page.evaluate(f"{unfolded}.length")
    assert count > page.locator(".js-plotly-plot .main-svg:first-child").count(), "some are below the window"
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    widths = page.evaluate("[...document.querySelectorAll('.js-plotly-plot .main-svg:first-child')].map((e) => e.clientWidth)")
    assert len(widths) == count
    assert min(widths) > 200
    assert max(widths) <= 900, "wider than the paper"
    context.close()


@pytest.mark.skipif(AXE is None, reason=NO_AXE)
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1400, 390])
@pytest.mark.parametrize("path", PAGES)
def test_axe_finds_nothing_serious(browser: Browser, site: Path, path: str, width: int, scheme: str) -> None:
    context = browser.new_context(
        viewport={"width": width, "height": 900},
        color_scheme=scheme,  # type: ignore[arg-type]
        bypass_csp=True,
    )
    page = context.new_page()
    page.goto((site / path).as_uri())
    found = findings(page)
    context.close()
    assert found == []
