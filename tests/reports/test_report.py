"""The page: complete, self-contained, true to its inputs."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from sample_crane import sample_gap, sample_unnamed

from sysid import display
from sysid.datasets.recording import Dataset
from sysid.gap.experiment.excitation_verdict import excitation_report
from sysid.gap.result import Check, EffectEvidence, Gap, GapResult, Promotion, WorldGap
from sysid.machine import load_machine
from sysid.plant import nominal_plant
from sysid.registry import ModelVersion
from sysid.reports import ReportInputs, build_report, write_report
from sysid.reports.picture import Mark, machine_picture
from sysid.reports.report import SECTIONS
from sysid.reports.sections.traces import worst_moment

VOID = {"meta", "br", "img", "input", "link", "line", "circle", "rect", "ellipse", "path"}


class Page(HTMLParser):
    """Collects what a browser would: text, ids, addresses; and checks that elements nest."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.addresses: list[str] = []
        self.scripts: dict[str, str] = {}
        self.words: list[str] = []
        self.rows: list[list[str]] = []
        self._open: list[str] = []
        self._script = ""
        self.feed(text)
        assert self._open == [], f"not closed: {self._open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if values.get("id"):
            self.ids.append(str(values["id"]))
        self.addresses += [str(values[key]) for key in ("src", "href", "action", "data") if values.get(key)]
        if tag == "script":
            self._script = str(values.get("id", ""))
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th") and self.rows:
            self.rows[-1].append("")
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self._open, f"</{tag}> closes nothing"
            assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open[-1:] == ["script"]:
            if self._script:
                self.scripts[self._script] = data
            return
        if "style" not in self._open:
            self.words.append(data)
            if {"td", "th"} & set(self._open) and self.rows:
                self.rows[-1][-1] += data

    @property
    def text(self) -> str:
        return " ".join("".join(self.words).replace("\N{NARROW NO-BREAK SPACE}", " ").split())

    def row(self, first: str) -> list[str]:
        row = next(row for row in self.rows if row and " ".join(row[0].split()) == first)
        return [" ".join(cell.replace("\N{NARROW NO-BREAK SPACE}", " ").split()) for cell in row]


@pytest.fixture(scope="module")
def gap(crane: Dataset) -> GapResult:
    return sample_gap(crane)


@pytest.fixture(scope="module")
def page(crane: Dataset, gap: GapResult) -> Page:
    notes = (ModelVersion("autolog", 2, "plant", "cd" * 32, {"dataset": "autolog@3"}),)
    found = excitation_report(crane, nominal_plant(crane.machine))
    return Page(build_report(ReportInputs(crane, gap, versions=notes, created="21 November 2026", excitation=found)))


def test_every_section_is_there_in_order(page: Page) -> None:
    names = [section.name for section in SECTIONS if section.name not in ("networks", "clocks")]
    assert [name for name in page.ids if name in names] == names
    assert len(page.ids) == len(set(page.ids)), "ids are unique"


def test_nothing_is_loaded_from_anywhere(page: Page, crane: Dataset) -> None:
    assert [address for address in page.addresses if not address.startswith("#")] == []
    own = re.sub(r"<script>.*?</script>", "", build_report(ReportInputs(crane)), count=1, flags=re.DOTALL)
    assert not re.search(r"https?://|@import|url\((?!#)", own)
    assert "default-src 'none'" in own, "a browser is told to refuse what slips through"


def test_plot_library_is_in_once(crane: Dataset, gap: GapResult) -> None:
    text = build_report(ReportInputs(crane, gap))
    assert text.count("plotly.js v") == 1
    assert len(text) < 9_000_000


def test_verdict_in_plain_words(page: Page) -> None:
    assert "Three effects are missing from the simulation." in page.text
    assert "The boom does not move until its command exceeds +0.0808 in one direction or −0.0493 in the other." in page.text
    assert "The slew has a backlash of 0.603°" in page.text
    assert "The tool swings on a pendulum of 220 mm" in page.text


def test_figures_are_those_of_the_result(page: Page, gap: GapResult) -> None:
    row = page.row("boom cylinder")
    assert float(row[1]) == pytest.approx(1e3 * gap.gap.before["boom.cylinder"], abs=0.006)
    assert float(row[2]) == pytest.approx(1e3 * gap.gap.after["boom.cylinder"], abs=0.006)
    assert row[4] == "mm"
    assert row[5] == "100 %"


def numbers(text: str) -> list[float]:
    """``280 mm → 0.361 mm`` as [m]; angles as [rad]."""
    scale = {"mm": 1e-3, "m": 1.0, "µm": 1e-6, "°": math.pi / 180.0}
    text = text.replace("\N{NARROW NO-BREAK SPACE}", "")
    return [float(value) * scale[unit] for value, unit in re.findall(r"([\d.]+)(mm|µm|m|°)", text)]


def test_every_error_on_the_page_is_that_of_the_json(crane: Dataset, gap: GapResult) -> None:
    stages = replace(gap.stage_gap, before={name: 0.7 * value for name, value in gap.stage_gap.before.items()})
    result = replace(gap, stage_gap=stages)
    text, stored = build_report(ReportInputs(crane, result)), result.to_json()

    def distance(kind: str, when: str, point: str) -> float:
        return math.hypot(*(value for name, value in stored[kind][when].items() if name.startswith(f"{point}.")))

    first = dict(re.findall(r"<div><dt>(\w+) position</dt> <dd>(.*?)</dd>", text))
    for point, word in (("tool", "tool"), ("ee", "tip")):
        expected = [distance("gap", when, point) for when in ("before", "after", "noise_floor")]
        assert numbers(re.sub("<[^>]*>", "", first[word])) == pytest.approx(expected, rel=6e-3)
    rows = dict(re.findall(r"<li><span>([^<]*)</span>.*?<small>([^<]*)</small></li>", text))
    for signal in ("boom.cylinder", "slew.joint"):
        expected = [stored["gap"][when][signal] for when in ("before", "after")]
        assert numbers(rows[signal.replace(".", " ")]) == pytest.approx(expected, rel=6e-3)
    cells = re.findall(r'<td style="[^"]*" data-stage="([^"]*)" class="\w*" title="([^:]*): ([^,]*),', text)
    found = {(stage, signal): numbers(error)[0] for stage, signal, error in cells}
    assert found["Tip → tool", "tool position"] == pytest.approx(distance("stage_gap", "before", "tool"), rel=0.06)
    assert found["Whole chain", "tool position"] == pytest.approx(distance("gap", "before", "tool"), rel=0.06)
    assert found["Command → actuator", "boom cylinder"] == pytest.approx(
        stored["stage_gap"]["before"]["boom.cylinder"], rel=0.06
    )


def test_the_path_in_space_is_coloured_by_the_error_of_the_tool(crane: Dataset, gap: GapResult) -> None:
    text = build_report(ReportInputs(crane, gap))
    trace = gap.traces[0]
    tool = ["tool.x", "tool.y", "tool.z"]
    largest = [
        1e3 * np.nanmax(np.linalg.norm(getattr(trace, when)[tool].to_numpy() - trace.measured[tool].to_numpy(), axis=1))
        for when in ("before", "after")
    ]
    captions = re.findall(r"<figcaption>tool in manual-04, [a-z ]*: at most ([\d.]+)\W*mm apart", text)
    assert [float(value) for value in captions] == pytest.approx(largest, rel=0.05)


def picture_of(inputs: ReportInputs) -> str:
    text = build_report(inputs)
    return text[text.index('<svg class="machine"') : text.index("</svg>")]


def test_culprits_are_marked_at_their_parts(crane: Dataset, gap: GapResult) -> None:
    picture = picture_of(ReportInputs(crane, gap))
    assert picture.count('class="valve hot"') == 1, "the dead-band sits at the valve of the boom"
    assert picture.count('class="joint hot"') == 1, "the play in the joint of the slew"
    assert 'class="tool hot"' in picture
    assert re.findall(r'<text class="badge"[^>]*>(\d)<', picture) == ["1", "2", "3"]
    assert picture.count('class="barrel"') == 2, "boom and stick have cylinders"


AUTOLOG = Path(__file__).parents[2] / "datasets" / "autolog" / "machine.toml"
CROWDED = (
    ("valve", "slew"),
    ("joint", "slew"),
    ("valve", "boom"),
    ("cylinder", "boom"),
    ("joint", "stick"),
    ("pump", "machine"),
)
FEW = (("joint", "slew"), ("valve", "boom"), ("tool", "tool"))


@pytest.mark.parametrize("wanted", [(), FEW, CROWDED])
@pytest.mark.parametrize("shipped", [True, False])
def test_nothing_on_the_picture_lies_on_anything_else(
    crane: Dataset, wanted: tuple[tuple[str, str], ...], shipped: bool
) -> None:
    machine = load_machine(AUTOLOG) if shipped else crane.machine
    picture = machine_picture(machine, [Mark(k, part, target) for k, (part, target) in enumerate(wanted, 1)])
    badges = [(float(x), float(y)) for x, y in re.findall(r'<circle class="badge" cx="([\d.]+)" cy="([\d.]+)"', picture)]
    words = re.findall(r'<text class="axis" x="([\d.]+)" y="([\d.]+)"[^>]*>(\w+)<', picture)
    boxes = [(float(x), float(y) - 5.0, 0.5 * 7.4 * len(text), 8.0) for x, y, text in words]
    boxes += [(x, y, 12.0, 12.0) for x, y in badges]
    valves = re.findall(r'class="valve(?: hot)?" transform="translate\(([\d.]+) ([\d.]+)\)', picture)
    boxes += [(float(x), float(y), 22.5, 9.0) for x, y in valves]
    boxes += [
        (float(x), float(y), 8.0, 8.0) for x, y in re.findall(r'class="joint(?: hot)?" cx="([\d.]+)" cy="([\d.]+)"', picture)
    ]
    assert len(badges) == len(wanted)
    assert len(valves) == 4
    width, height = map(float, re.findall(r'viewBox="0 0 (\d+) (\d+)"', picture)[0])
    for k, (x, y, w, h) in enumerate(boxes):
        assert w <= x <= width - w
        assert h <= y <= height - h
        assert not any(abs(x - a) < w + c and abs(y - b) < h + d for a, b, c, d in boxes[:k])


def test_cards_say_where_how_sure_and_what_share(page: Page) -> None:
    assert "At the valve of the boom. Explains 63 % of the error of its stage." in page.text
    assert "At the joint of the slew (between joint sensor and structure)." in page.text
    assert "Its values are known to within ±5.8 %." in page.text
    assert "20 slow reversals of stick, with at least 5 % of its range between them." in page.text


def test_evidence_says_why_the_others_lost(page: Page) -> None:
    assert "predicts 310 ± 25 nats worse" in page.text
    assert page.row("Wrong speed gain")[-1] == "predicts 2566 ± 70 nats worse"


def test_who_owns_the_gap_and_when_it_happens(page: Page) -> None:
    assert "over manual-01, manual-02, manual-03 and poses" in page.text, "shares are of the recordings of the fits"
    assert "70 % boom Command → actuator" in page.text
    assert "1 other stage below 1 %." in page.text
    assert "The speed error depends most on boom command, which explains 91 % of it (largest at 0.60: −2.0 mm/s)." in page.text


def test_the_worst_moments_are_shown(crane: Dataset, gap: GapResult, page: Page) -> None:
    worst = worst_moment(gap.traces, "boom.cylinder", "before")
    assert worst is not None
    trace = gap.traces[0]
    errors = abs(trace.before["boom.cylinder"].to_numpy() - trace.measured["boom.cylinder"].to_numpy())
    assert worst.before == pytest.approx(errors.max())
    assert worst.time == trace.measured["time"].to_numpy()[errors.argmax()]
    shown = display.quantity(worst.before, "m", 2).replace("\N{NARROW NO-BREAK SPACE}", " ")
    assert f"boom cylinder, manual-04 at {worst.time:.1f} s: error {shown} before" in page.text
    assert "largest error after: " in page.text


def test_a_localisation_marks_the_stages_and_names_nothing(crane: Dataset, gap: GapResult) -> None:
    located = replace(
        gap, verdict="unnamed", effects=(), candidates=(), next_experiment=(), settings={"localise_only": True}, plant_after=""
    )
    page = Page(build_report(ReportInputs(crane, located)))
    assert "Simulation and machine disagree at: " in page.text
    assert "Name causes sysid gap autolog@3" in page.text
    assert "of the explained" not in page.text
    assert "Valve dead-band" not in page.text.split("What to record next")[0]
    assert 'class="valve hot"' in picture_of(ReportInputs(crane, located))


def test_traces_carry_the_signals_with_their_gaps(page: Page, gap: GapResult) -> None:
    import base64

    data = json.loads(page.scripts["traces-data"])["recordings"]["manual-04"]
    tip = np.frombuffer(base64.b64decode(data["signals"]["ee.z"]["measured"]["bdata"]), dtype="<f4")
    expected = 1e3 * gap.traces[0].measured["ee.z"].to_numpy()
    assert np.isnan(tip[1210:1230]).all(), "the drop-out of the motion capture stays a gap"
    np.testing.assert_allclose(tip, expected, rtol=1e-5)
    assert sorted(data["commands"]) == ["boom", "slew", "stick", "telescope"]


def test_a_machine_without_geometry_and_a_name_full_of_markup(crane: Dataset, gap: GapResult) -> None:
    machine = replace(crane.machine, name="<b>&amp;", urdf_text=None, tip=None)
    page = Page(build_report(ReportInputs(replace(crane, machine=machine), gap)))
    assert "<b>&amp;" in page.text
    assert "boom cylinder" in page.text


def test_an_abstention_offers_no_name(crane: Dataset) -> None:
    page = Page(build_report(ReportInputs(crane, sample_unnamed(crane))))
    assert "cannot distinguish the remaining candidate effects" in page.text
    assert "Spool hysteresis of boom or Backlash of boom" in page.text
    assert "0.004 − 0.031·boom.cylinder" in page.text
    assert "parameters" not in page.ids


def test_dataset_alone_makes_a_page(crane: Dataset) -> None:
    page = Page(build_report(ReportInputs(crane)))
    assert "have not been compared yet" in page.text
    assert "truncated: last 0.31 s unreadable" in page.text
    assert "the machine stands still: nothing to align on" in page.text
    assert page.row("manual-04")[1] == "held out"


def test_same_inputs_same_bytes(crane: Dataset, gap: GapResult) -> None:
    assert build_report(ReportInputs(crane, gap)) == build_report(ReportInputs(crane, gap))


def test_written_whole_into_a_new_folder(tmp_path: Path, crane: Dataset) -> None:
    path = write_report(tmp_path / "a" / "b" / "report.html", ReportInputs(crane))
    assert path.read_text("utf-8").rstrip().endswith("</html>")
    assert [file.name for file in path.parent.iterdir()] == ["report.html"]


def judged(gap: GapResult, *checks: Check) -> GapResult:
    """The result with a promotion, refused where a check failed, and the same gap in a world in which the tool swings on."""
    failed = [check.text for check in checks if check.status == "failed"]
    promotion = Promotion("autolog@2", "autolog@1" if failed else "autolog@2", "autolog@1", checks, "; ".join(failed))
    evidence = EffectEvidence(6614.0, 2312.0, 0.000999, 11.5)
    swinging = replace(gap.gap, after={s: (4.0 if s.startswith("tool") else 1.0) * v for s, v in gap.gap.after.items()})
    return replace(
        gap,
        effects=tuple(replace(effect, evidence=evidence) for effect in gap.effects),
        world_gap=WorldGap(swinging, gap.gap, ("manual-04",), 2.9),
        machine_diff="--- machine.toml\n+++ machine.toml\n@@ -1 +1 @@\n+[[effects]]\n",
        promotion=promotion,
    )


def test_the_proof_says_what_was_asked_and_what_is_in_use(crane: Dataset, gap: GapResult) -> None:
    stages = Check("stages", "passed", "command stage of boom 259 → 0.99 noise floors")
    page = Page(build_report(ReportInputs(crane, judged(gap, stages))))
    assert "autolog@2 is promoted." in page.text
    assert "The error of the repaired stages is smaller" in page.text
    assert "259 → 0.99 noise floors" in page.text
    assert "sysid models promote autolog@1" in page.text, "the way back"
    assert ["Valve dead-band", "boom", "63\u202f%", "12\u202f×"] in page.rows
    assert "The tool position has a larger error there than in the compiled plant" in page.text
    assert "@@ -1 +1 @@" in page.text, "the change of machine.toml to copy"


def test_a_refused_promotion_says_why_and_how_all_the_same(crane: Dataset, gap: GapResult) -> None:
    grown = Check("free run", "failed", "further off than before: stick.joint 0.0009 → 0.0012 rad (at most 0.00095 rad)")
    result = judged(gap, grown, Check("world", "left out", "not run"))
    nothing = Gap({}, {}, {})
    missing = WorldGap(nothing, nothing, (), 0.0, "pybullet is not installed (Python 3.12)")
    page = Page(build_report(ReportInputs(crane, replace(result, world_gap=missing))))
    assert "autolog@2 is stored, but not promoted." in page.text
    assert "Further off than before: stick.joint" in page.text
    assert "alone still refers to autolog@1" in page.text
    assert "sysid models promote autolog@2 --anyway" in page.text
    assert "Not run: pybullet is not installed (Python 3.12)" in page.text
