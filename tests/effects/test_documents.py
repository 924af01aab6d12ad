"""The committed pages are what the code says."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from effect_pages import documents
from sysid.effects import CATALOGUE

FOLDER = Path(__file__).parents[2] / "docs" / "effects"
NUMBER = re.compile(r"-?\d+\.\d+")


@pytest.fixture(scope="module")
def made() -> dict[str, str]:
    return documents()


def test_the_folder_holds_these_pages_and_no_others(made: dict[str, str]) -> None:
    assert {path.name for path in FOLDER.iterdir()} == set(made)


def test_pages_are_up_to_date(made: dict[str, str]) -> None:
    stale = [n for n, text in made.items() if n.endswith(".md") and (FOLDER / n).read_text("utf-8") != text]
    assert not stale, "run: python pipelines/effect_pages.py docs/effects"


@pytest.mark.parametrize("name", [effect.name for effect in CATALOGUE])
def test_pictures_are_up_to_date(made: dict[str, str], name: str) -> None:
    """Up to what another processor rounds differently: a fifth of a pixel."""
    fresh, kept = made[f"{name}.svg"], (FOLDER / f"{name}.svg").read_text("utf-8")
    assert NUMBER.sub("#", fresh) == NUMBER.sub("#", kept), "run: python pipelines/effect_pages.py docs/effects"
    numbers = [np.array([float(x) for x in NUMBER.findall(text)]) for text in (fresh, kept)]
    assert np.allclose(*numbers, atol=0.21)


@pytest.mark.parametrize("name", [effect.name for effect in CATALOGUE])
def test_every_colour_of_a_picture_is_legible_on_a_dark_page(made: dict[str, str], name: str) -> None:
    """On the background that a dark page gives it: words 4.5 to 1, curves 3 to 1."""
    style = re.search(r"<style>@media \(prefers-color-scheme:dark\)\{(.*?)\}</style>", made[f"{name}.svg"])
    assert style is not None
    dark = dict(re.findall(r'\[fill="(#\w+)"\]\{fill:(#\w+)\}', style[1]))
    picture = made[f"{name}.svg"].replace(style[0], "")
    for kind, least in (("<text[^>]*fill", 4.5), ("<polyline[^>]*stroke", 3.0)):
        for colour in set(re.findall(rf'{kind}="(#\w+)"', picture)):
            assert contrast(dark.get(colour, colour), dark["#ffffff"]) >= least, colour


def contrast(one: str, other: str) -> float:
    """Of two colours, as WCAG 2 defines it."""
    light = sorted(0.05 + luminance(colour) for colour in (one, other))
    return light[1] / light[0]


def luminance(colour: str) -> float:
    parts = np.array([int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)])
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_pictures_show_a_difference(made: dict[str, str], effect: object) -> None:
    root = ET.fromstring(made[f"{effect.name}.svg"])  # type: ignore[attr-defined]
    curves = [element.get("points") for element in root.iter("{http://www.w3.org/2000/svg}polyline")]
    assert len(curves) >= 2
    with_effect, without = (
        np.array([[float(v) for v in p.split(",")] for p in (points or "").split()]) for points in (curves[-1], curves[-2])
    )
    if len(with_effect) != len(without):  # a clock that is wrong: one curve begins later; compared where both are drawn
        both = (without[:, 0] >= with_effect[0, 0]) & (without[:, 0] <= with_effect[-1, 0])
        assert both.sum() > 0.9 * len(without)
        without = without[both]
        with_effect = np.column_stack([without[:, 0], np.interp(without[:, 0], *with_effect.T)])
    assert np.abs(with_effect - without).max() > 5.0, "pixels"


def test_what_separates_two_effects_is_on_the_pages_of_both(made: dict[str, str]) -> None:
    for effect in CATALOGUE:
        for other, text in effect.confused_with.items():
            assert text in made[f"{effect.name}.md"]
            assert text in made[f"{other}.md"]
