"""The pages of a workspace: complete, linked, and made again only where something changed."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
from sample_workspace import sample_workspace

from sysid.figures import ErrorFigure
from sysid.site import Built, build_site, inventory
from sysid.site.item import Item
from sysid.site.sparklines import sparklines
from sysid.workspace import Workspace, open_workspace


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    return sample_workspace(tmp_path_factory.mktemp("site") / "ws")


@pytest.fixture(scope="module")
def built(place: Workspace) -> Built:
    return build_site(place)


class Links(HTMLParser):
    """The ``href`` and ``src`` of a page, and its ``id``."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.ids: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.links += [value for key in ("href", "src") if (value := values.get(key))]
        self.ids |= {value for key in ("id",) if (value := values.get(key))}


def items(place: Workspace) -> dict[str, Item]:
    return {item.key: item for item in inventory(place)}


def test_the_lineage_goes_from_raw_files_to_the_champion(place: Workspace) -> None:
    found = items(place)
    assert found["dataset:autolog@1"].parents == ("logs:autolog@1",)
    assert found["dataset:autolog@2"].parents == ("dataset:autolog@1",)
    assert found["gap:autolog@1"].parents == ("dataset:autolog@1", "plant:autolog@1")
    assert "gap:autolog@1" in found["plant:autolog@2"].parents
    assert found["plant:autolog@2"].aliases == ("champion",)
    assert set(found["plant:autolog@1"].parents) == {"dataset:autolog@1", "actuator:autolog-actuator@2"}


def test_what_is_damaged_is_an_item_with_its_reason(place: Workspace) -> None:
    damaged = next(item for item in inventory(place) if item.kind == "damaged")
    assert damaged.damage.startswith("gap result of autolog@2: Expecting")


def test_every_item_has_its_page_and_every_link_leads_to_one(place: Workspace, built: Built) -> None:
    folder = built.index.parent
    assert built.failed == {}
    pages = {path: Links(path.read_text("utf-8")) for path in folder.rglob("*.html")}
    assert {item.path for item in inventory(place) if item.path} <= {str(path.relative_to(folder)) for path in pages}
    for path, page in pages.items():
        for link in page.links:
            file, _, anchor = link.partition("#")
            target = (path.parent / unquote(file)).resolve() if file else path
            assert target.is_file(), f"{path.name}: {link}"
            if anchor and "=" not in anchor:
                assert unquote(anchor) in pages[target].ids, f"{path.name}: {link}"


def test_no_page_loads_anything_from_elsewhere(built: Built) -> None:
    for path in built.index.parent.rglob("*.html"):
        text = path.read_text("utf-8").replace("http://www.w3.org", "")
        assert not re.search(r"(src|href)=.https?:", text), path.name
        assert "default-src 'none'" in text


def test_only_pages_with_a_change_are_made_again(tmp_path: Path) -> None:
    place = sample_workspace(tmp_path)
    build_site(place)
    again = build_site(place)
    assert again.made == ()
    place.models.register("autolog", "plant", {"plant.json": b"[]"}, {"dataset": "autolog@2"})
    after = build_site(place)
    assert "models/autolog@3.html" in after.made
    assert "models/autolog@2.html" in after.made  # it links to its newer version
    assert {"models/autolog-actuator@1.html", "reports/autolog@1.html"} <= set(after.kept)
    (tmp_path / "site/models/autolog@3.html").unlink()
    assert build_site(place).made == ("models/autolog@3.html",)


def test_pages_of_what_is_gone_are_removed(tmp_path: Path) -> None:
    place = sample_workspace(tmp_path)
    build_site(place)
    place.datasets.files.remove("datasets/autolog/versions/000002.json")
    build_site(place)
    assert not (tmp_path / "site/datasets/autolog@2.html").exists()
    assert (tmp_path / "site/datasets/autolog@1.html").exists()


def test_a_page_that_cannot_be_made_does_not_stop_the_others(tmp_path: Path) -> None:
    place = sample_workspace(tmp_path)
    traces = tmp_path / "results/autolog@1/gap/traces.parquet"
    traces.write_bytes(traces.read_bytes()[:-1])
    built = build_site(place)
    assert list(built.failed) == ["reports/autolog@1.html"]
    assert "changed after it was written" in built.failed["reports/autolog@1.html"]
    assert "index.html" in built.made
    assert "reports/autolog@1.html" not in build_site(place).kept


def test_names_and_texts_of_others_are_escaped(tmp_path: Path) -> None:
    place = open_workspace(tmp_path)
    lineage = {"dataset": "d@1", "recipe": {"<img src=x>": "</script><b>"}}
    place.models.register("p", "plant", {"plant.json": b"{}"}, lineage)
    build_site(place)
    for name in ("index.html", "compare.html", "models/p@1.html"):
        text = (tmp_path / "site" / name).read_text("utf-8")
        assert "<img" not in text
        assert "</script><b>" not in text


def test_an_item_without_pages_has_no_link() -> None:
    assert Item("damaged", "a@1", damage="x").href == ""
    assert replace(Item("logs", "a@1"), kind="dataset").href == "datasets/a%401.html"


def test_the_first_page_has_the_newest_result_with_its_figures(place: Workspace, built: Built) -> None:
    text = built.index.read_text("utf-8")
    own = text[text.index('<section id="newest">') : text.index('<section id="use">')]
    gap = place.gap(place.dataset("autolog@1"))
    assert gap is not None
    assert gap.headline in own
    assert own.count('<text class="badge"') == 3
    before, after = (math.hypot(*(part[f"tool.{k}"] for k in "xyz")) for part in (gap.gap.before, gap.gap.after))
    tool = ErrorFigure("", "m", before, after, 0.0)
    assert f'<b class="before">{tool.texts[0]}</b> → <b class="after">{tool.texts[1]}</b>' in own


def test_each_signal_is_a_curve_with_flags_and_roles(place: Workspace) -> None:
    dataset = place.dataset("autolog@1")
    manifest: dict[str, Any] = {
        "units": dataset.units,
        "splits": {"manual-01": "held_out"},
        "quality": {
            "flags": [
                {
                    "recording": "manual-01",
                    "signal": "boom.joint",
                    "kind": "dropout",
                    "from_s": 3.0,
                    "to_s": 6.0,
                    "text": "none",
                }
            ]
        },
    }
    table = sparklines(dataset.recordings, manifest)  # type: ignore[arg-type]
    names = [recording.name for recording in dataset.recordings]
    assert "manual-01<br><small>held out" in str(table.header[1 + names.index("manual-01")])
    row = next(row for row in table.rows if str(row[0]).startswith("boom.joint"))
    cell = str(row[1 + names.index("manual-01")])
    recording = dataset.recordings[names.index("manual-01")]
    seconds = (len(recording.table) - 1) / recording.rate_hz
    x, width = map(float, re.findall(r'class="flagged" x="([\d.]+)" width="([\d.]+)"', cell)[0])
    assert (x, width) == pytest.approx((96.0 * 3.0 / seconds, 96.0 * 3.0 / seconds), abs=0.1)
    assert "dropout: none" in cell
    assert 'class="flagged"' not in str(row[1 + names.index("manual-02")])
    heights = [float(y) for y in re.findall(r",([\d.]+)", cell)]
    values = np.concatenate([own.values("boom.joint") for own in dataset.recordings if "boom.joint" in own.signals])
    shares = (recording.values("boom.joint") - np.nanmin(values)) / np.ptp(values[np.isfinite(values)])
    assert min(heights) == pytest.approx(2.0 + 22.0 * (1.0 - np.nanmax(shares)), abs=1.5), "one scale for all recordings"
