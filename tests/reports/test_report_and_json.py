"""Every figure that the report shows as a property of the answer is that of the JSON: errors, floors, parameters, costs."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import pytest
from sample_crane import sample_gap
from test_report import Page

from sysid.datasets.recording import Dataset
from sysid.gap.result import EffectEvidence, Gap, GapResult, WorldGap
from sysid.reports import ReportInputs, build_report

#: Unit on the page → SI.
SCALE = {"mm": 1e-3, "µm": 1e-6, "m": 1.0, "ms": 1e-3, "s": 1.0, "°": math.pi / 180.0, "%": 1e-2, "×": 1.0, "": 1.0}
NUMBER = r"[-−]?\d[\d\u202f]*(?:\.\d+)?"
SHOWN = re.compile(rf"(?<![\w.])({NUMBER})(?: to ({NUMBER}))?(?:[\u202f ]?(mm|µm|ms|%|°|×|m|s)(?!\w))?")


def shown(text: str) -> list[tuple[float, float]]:
    """Each number of a text in SI, with half a unit of its last digit."""
    found = []
    for low, high, unit in SHOWN.findall(text):
        for number in filter(None, (low, high)):
            plain = number.replace("\u202f", "").replace("−", "-")
            digits = len(plain.partition(".")[2])
            found.append((float(plain) * SCALE[unit], 0.5001 * 10.0**-digits * SCALE[unit]))
    return found


def assert_shows(text: str, expected: list[float]) -> None:
    """``text`` has these numbers, rounded, in this order, and no other."""
    found = shown(text)
    assert len(found) == len(expected), f"{text!r}: {expected}"
    for (value, half), wanted in zip(found, expected, strict=True):
        assert abs(value - wanted) <= half + 1e-12, f"{text!r}: {wanted}"


@pytest.fixture(scope="module")
def result(crane: Dataset) -> GapResult:
    """The sample, with everything that a report may show, and no two figures alike."""
    gap = sample_gap(crane)

    def scaled(source: Gap, factor: float) -> Gap:
        grown = [
            {name: factor**power * (1.0 + 0.01 * k) * value for k, (name, value) in enumerate(values.items())}
            for power, values in ((1, source.before), (0.5, source.after), (0, source.noise_floor))
        ]
        return Gap(*grown)

    evidence = [EffectEvidence(6614.0, 2312.0, 0.000999, 11.5), EffectEvidence(912.0, 402.0, 0.00203, 4.4)]
    evidence.append(EffectEvidence(88.0, 31.0, 0.0301, 1.7))
    return replace(
        gap,
        gap=scaled(gap.gap, 1.2),
        stage_gap=scaled(gap.gap, 0.8),
        effects=tuple(replace(effect, evidence=own) for effect, own in zip(gap.effects, evidence, strict=True)),
        world_gap=WorldGap(scaled(gap.gap, 1.4), scaled(gap.gap, 1.1), ("manual-04",), 2.9),
    )


@pytest.fixture(scope="module")
def html(crane: Dataset, result: GapResult) -> str:
    return build_report(ReportInputs(crane, result))


@pytest.fixture(scope="module")
def stored(result: GapResult) -> dict[str, Any]:
    return result.to_json()


def table(html: str, *header: str) -> Iterator[list[str]]:
    """The rows of every table that begins with these columns."""
    for chunk in re.findall(r"<table.*?</table>", html, re.DOTALL):
        first, *rows = Page(chunk).rows
        if tuple(first[: len(header)]) == header:
            yield from rows


def errors(values: Mapping[str, Mapping[str, float]]) -> dict[str, list[float]]:
    """Name on the page → before, after, noise floor; the coordinates of a point are one distance."""
    found: dict[str, list[list[float]]] = {}
    for name in values["before"]:
        owner, _, quantity = name.rpartition(".")
        shown_as = {"ee": "tip position", "tool": "tool position"}.get(owner, f"{owner} {quantity}")
        found.setdefault(shown_as, []).append([values[when][name] for when in ("before", "after", "noise_floor")])
    return {name: [math.hypot(*column) for column in zip(*rows, strict=True)] for name, rows in found.items()}


def test_errors_of_the_first_screen_and_of_every_signal(html: str, stored: dict[str, Any]) -> None:
    expected = errors(stored["gap"])
    first = re.findall(r"<div><dt>([^<]*)</dt> <dd>(<b class=\"before\">.*?)</dd></div>", html)
    assert [name for name, _ in first] == ["tool position", "tip position"]
    for name, text in first:
        assert_shows(re.sub("<[^>]*>", " ", text), expected[name])
    listed = re.findall(r"<li><span>([^<]*)</span>.*?<small>([^<]*)</small></li>", html)[: len(expected)]
    assert [name for name, _ in listed] == list(expected)
    for name, text in listed:
        assert_shows(text, expected[name][:2])
    rows = list(table(html, "Signal", "Before", "After", "Noise floor", "Unit", "Closed"))
    assert [row[0] for row in rows] == list(expected)
    for name, *figures, unit, closed in rows:
        before, after, floor = expected[name]
        assert_shows(" ".join(f"{figure}{unit}" for figure in figures), [before, after, floor])
        if closed != "–":
            assert_shows(closed, [(before - after) / (before - floor)])


def test_errors_of_every_stage_and_shares(html: str, stored: dict[str, Any]) -> None:
    stages, chain = errors(stored["stage_gap"]), errors(stored["gap"])
    cells = re.findall(r'<td style="[^"]*" data-stage="([^"]*)" class="\w*" title="([^:]*): ([^,]*),[^"]*">(.*?)</td>', html)
    assert {signal for _, signal, _ in [cell[:3] for cell in cells]} == set(chain)
    for stage, signal, error, text in cells:
        before, _, floor = (chain if stage == "Whole chain" else stages)[signal]
        assert_shows(error, [before])
        assert_shows(re.sub("<[^>]*>", " ", text), [before / floor, before])
    shares = [share["share"] for share in stored["shares"] if share["share"] >= 0.01]
    text = html.split("Shares of the whole gap")[1].split("Error maps")[0]
    found = [shown(percent)[0] for percent in re.findall(r"[\d.]+\u202f%", text)][: len(shares)]
    assert sorted(value for value, _ in found) == pytest.approx(sorted(shares), abs=0.00501)


def test_values_intervals_and_shares_of_the_effects(html: str, stored: dict[str, Any]) -> None:
    briefs = re.findall(r'<li><b class="number">\d+</b><span>.*?<small>(.*?)</small></span></li>', html)
    cards = re.findall(r"<p class=\"quiet\">(At the .*?)</li>", html, re.DOTALL)
    values = iter(table(html, "Effect", "Where", "Parameter", "Value", "95 % interval"))
    proof = list(table(html, "Effect", "Where", "Closes of its stage's gap", "Error without it"))
    evidence = list(table(html, "Effect", "Where", "2 Δ log evidence", "Nats", "p-value"))
    for effect, brief, card, closes, costs in zip(stored["effects"], briefs, cards, proof, evidence, strict=True):
        triples = [(value, *effect["interval95"][name]) for name, value in effect["parameters"].items()]
        assert_shows(brief, [number for triple in triples for number in triple])
        for value, low, high in triples:
            _, _, _, one, interval, *_ = next(values)
            assert_shows(one, [value])
            assert_shows(interval, [low, high])
        widest = max((high - low) / 2.0 / abs(value) for value, low, high in triples)
        assert_shows(re.search("Explains ([^ ]*)", card)[1], [effect["gap_share"]])  # type: ignore[index]
        assert_shows(re.search("±([^.]*\\.?\\d*\u202f%)", card)[1], [widest])  # type: ignore[index]
        assert_shows(closes[2], [effect["gap_share"]])
        assert_shows(closes[3], [effect["evidence"]["ratio"]])
        assert_shows(" ".join(costs[2:4]), [effect["evidence"]["delta_bic"], effect["evidence"]["nats"]])
        assert_shows(costs[4], [effect["evidence"]["p_value"]])
    assert next(values, None) is None


def test_costs_and_values_of_every_fit(html: str, stored: dict[str, Any]) -> None:
    rows = list(table(html, "Added", "Fitted values", "Error", "2 Δ log evidence", "Result"))
    assert len(rows) == len(stored["candidates"])
    left = list(stored["candidates"])
    for _, fitted, error, cost, _ in rows:
        same = [fit for fit in left if abs(shown(error)[0][0] - fit["fit_rmse"]) < 0.00501]
        fit = min(same, key=lambda fit: abs(shown(cost)[0][0] - fit["delta_bic"]))
        assert_shows(cost, [fit["delta_bic"]])
        assert_shows(fitted, list(fit["parameters"].values()))
        left.remove(fit)


def test_errors_in_the_world_and_counts_of_excitation(html: str, stored: dict[str, Any], result: GapResult) -> None:
    assert result.world_gap is not None
    there = errors(stored["world_gap"])
    plain = errors({when: stored["world_gap"]["compiled"][when] for when in ("before", "after", "noise_floor")})
    rows = list(table(html, "Signal", "Before", "compiled", "After", "compiled", "Noise floor", "Unit"))
    assert [row[0] for row in rows] == list(there)
    for name, *figures, unit in rows:
        (before, after, floor), (compiled_before, compiled_after, _) = there[name], plain[name]
        expected = [before, compiled_before, after, compiled_after, floor]
        assert_shows(" ".join(f"{figure}{unit}" for figure in figures), expected)
    counts = [
        [number for number, _ in shown(" ".join(row[2:]))] for row in table(html, "Effect", "Where", "Recorded", "Needed")
    ]
    assert sorted(counts) == sorted([item["have"], item["need"]] for item in stored["excitation"])


@pytest.mark.parametrize(
    ("text", "expected"),
    [("220 mm (218 to 221 mm)", [0.220, 0.218, 0.221]), ("6\u202f614", [6614.0]), ("−0.2°", [-0.2 * math.pi / 180.0])],
)
def test_numbers_of_a_text_are_in_si(text: str, expected: list[float]) -> None:
    assert_shows(text, expected)
    with pytest.raises(AssertionError):
        assert_shows(text, [1.5 * value for value in expected])
