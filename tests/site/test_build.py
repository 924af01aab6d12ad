"""The pages of a workspace: complete, linked, and made again only where something changed."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from sample_workspace import sample_workspace

from sysid.site import Built, build_site, inventory
from sysid.site.item import Item
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
