"""What the recordings contain and could show, on the page: pictures true to the figures, verdicts in words."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from markupsafe import Markup

from sysid.datasets.quality.evidence import DatasetEvidence, evidence_of
from sysid.datasets.quality.use import CELLS
from sysid.datasets.recording import Dataset
from sysid.gap.experiment.excitation_verdict import ExcitationReport, ExcitationVerdict, RecordingRequest, excitation_report
from sysid.machine import Machine
from sysid.plant import nominal_plant
from sysid.reports import ReportInputs, build_report
from sysid.reports.dataset_texts import VerdictGroup, amount, by_effect, by_reason, flag_lines, kinds_of, request_text, spread
from sysid.reports.sections import excitation as section
from sysid.reports.sections import quality
from sysid.reports.sections.quality import MAP, MAP_LEFT, MAP_TOP, command_picture, map_picture


@pytest.fixture(scope="module")
def evidence(crane: Dataset) -> DatasetEvidence:
    return evidence_of(crane)


@pytest.fixture(scope="module")
def verdicts(crane: Dataset) -> ExcitationReport:
    return excitation_report(crane, nominal_plant(crane.machine))


def verdict(
    name: str = "backlash", target: str = "slew", have: float | None = 4.0, side: str | None = "drive"
) -> ExcitationVerdict:
    status = "hidden" if have is None else "ready" if have >= 8.0 else "lacking"
    need = None if have is None else 8.0
    return ExcitationVerdict(name, target, "command", side, status, have, need, "reversals", "text", "")  # type: ignore[arg-type]


def test_bars_are_as_high_as_the_times(evidence: DatasetEvidence) -> None:
    use = replace(evidence.axes["slew"], seconds=(0.0, 4.0, 2.0, 0.1, *([0.0] * (CELLS - 4))))
    text = command_picture(use, "1", small=True)
    heights = [float(h) for h in re.findall(r'class="bar(?: thin)?"[^>]* height="([\d.]+)"', text)]
    assert len(heights) == CELLS
    assert heights[1] == pytest.approx(2.0 * heights[2], abs=0.1)
    assert text.count("bar thin") == CELLS - 2, "what was never held long enough is faint"
    assert text.count('class="noise"') == 2, "a band on either side"
    assert "4.00 s at −0.90 to −0.80" in text
    servo = command_picture(use, "rad", small=False)
    assert 'class="noise"' not in servo
    assert "command [°]" in servo


def test_cells_lie_where_the_machine_was(crane: Dataset, evidence: DatasetEvidence) -> None:
    item = next(m for m in evidence.maps if (m.first.axis, m.second.axis) == ("slew", "stick"))
    text = map_picture(item, evidence.postures, crane.units)
    cells = [(float(x), float(y)) for x, y in re.findall(r'class="cell"[^>]* x="([\d.]+)" y="([\d.]+)"', text)]
    assert len(cells) == round(100 * item.covered_moving)
    assert all(MAP_LEFT <= x <= MAP_LEFT + MAP and MAP_TOP <= y <= MAP_TOP + MAP for x, y in cells)
    columns = {round((x - MAP_LEFT) / (MAP / 10) - 0.025) for x, _ in cells}
    visited = {row for row in range(10) if any(s >= 0.2 for s in item.seconds[row])}
    assert columns == visited
    assert text.count('class="pose"') == int(np.sum(np.array(item.poses) > 0))


def test_the_page_names_what_is_missing_and_where(crane: Dataset, verdicts: ExcitationReport) -> None:
    values = section.context(ReportInputs(crane, excitation=verdicts))
    assert values is not None
    assert values["ready"] + values["lacking"] + values["hidden"] == values["total"] == len(verdicts.verdicts)
    assert values["columns"] == ["slew", "boom", "stick", "telescope"]
    first = values["rows"][0]
    assert first["lacks"], "what lacks something comes first"
    row = next(row for row in values["rows"] if row["title"] == "Backlash" and row["side"] == "ahead of the sensor")
    slew = next(v for v in verdicts.verdicts if (v.name, v.target, v.side) == ("backlash", "slew", "drive"))
    cell = row["cells"][0]
    assert (cell["status"], cell["title"]) == (slew.status, slew.text)
    assert cell["width"] == pytest.approx(min(50.0 * (slew.have or 0.0) / (slew.need or 1.0), 100.0), abs=0.1)
    others = [row["cells"][-1] for row in values["rows"] if row["title"] == "Pump flow limit"]
    assert others[0]["place"] == "whole machine"
    assert section.context(ReportInputs(crane)) is None


def test_two_sensors_of_an_axis_share_a_cell_that_shows_the_worse(crane: Dataset) -> None:
    pair = (verdict("sensor_bias", "boom.cylinder", 9.0, None), verdict("sensor_bias", "boom.joint", 3.0, None))
    values = section.context(ReportInputs(crane, excitation=ExcitationReport("d@1", "p@1", ("a",), pair)))
    assert values is not None
    (row,) = values["rows"]
    assert values["columns"] == ["boom"]
    assert (row["cells"][0]["status"], row["cells"][0]["have"]) == ("lacking", "3")


FLAG = {"recording": "manual-01", "source": "m.csv", "signal": "ee.x", "kind": "marker_swap", "from_s": 1.0, "to_s": 1.25}


def test_flags_of_ingest_are_told(crane: Dataset) -> None:
    flagged = replace(crane, quality={**crane.quality, "flags": [{**FLAG, "samples": 2, "text": "two markers <swapped>"}]})
    text = build_report(ReportInputs(flagged))
    assert "Flagged by ingest: 1 × marker swap" in text
    assert "two markers &lt;swapped&gt;" in text
    assert "Flagged by ingest" not in build_report(ReportInputs(crane))


def test_implausible_values_are_listed(crane: Dataset) -> None:
    degrees = [
        replace(r, table=r.table.assign(**{"slew.joint": np.degrees(r.values("slew.joint"))}))
        for r in crane.recordings
    ]  # fmt: skip
    text = build_report(ReportInputs(replace(crane, recordings=tuple(degrees))))
    assert "<h3>Implausible</h3>" in text
    assert "slew.joint is in degrees, but read as rad" in text
    assert "<h3>Implausible</h3>" not in build_report(ReportInputs(crane))


def test_a_gap_of_a_file_is_one_line_and_wrong_values_come_first() -> None:
    gap = {**FLAG, "kind": "dropout", "text": "nothing for 0.3 s"}
    flags = [{**gap, "signal": f"{name}.joint"} for name in ("slew", "boom", "stick", "boom", "telescope")]
    lines = flag_lines([*flags, {**FLAG, "text": "swap"}, {**gap, "from_s": 0.5, "recording": "manual-02"}])
    assert [line.kind for line in lines] == ["marker swap", "dropout", "dropout"]
    assert lines[1].signals == "slew joint, boom joint and 2 more"
    assert kinds_of(lines) == "1 × marker swap, 2 × dropout"
    assert flag_lines([]) == []


def test_a_dataset_without_motion_has_a_section_too(crane: Dataset) -> None:
    still = replace(crane, recordings=crane.of_kind("poses"), splits={})
    values = quality.context(ReportInputs(still))
    assert values["axes"] == []
    assert values["rest"] == "The machine was never at rest for a second."
    assert all(isinstance(item, Markup) for item in values["maps"])
    assert "Joint space" in build_report(ReportInputs(still))


def test_amounts_never_round_up_to_enough() -> None:
    assert amount(verdict(have=4.0)) == "4 of 8"
    assert amount(verdict(have=7.96)) == "7.96 of 8"
    assert amount(verdict(have=None)) == "–"
    assert spread(VerdictGroup("", (verdict(have=3.0), verdict(have=12.4)))) == "3 to 12"
    assert spread(VerdictGroup("", (verdict(have=12.1), verdict(have=12.4)))) == "12"


def test_groups_name_each_place_once(crane_machine: Machine) -> None:
    sides = [verdict(side="drive"), verdict(target="boom", side="drive"), verdict(side="structure")]
    (group,) = by_effect(sides, crane_machine)
    assert group.places == "slew, boom ahead of the sensor; slew behind the sensor"
    hidden = [replace(verdict(have=None), text="no URDF"), replace(verdict("stiction", have=None), text="not measured")] * 2
    reasons = by_reason([*hidden, hidden[0]], crane_machine)
    assert [(why, len(groups)) for why, groups in reasons] == [("no URDF", 1), ("not measured", 1)]


def test_shares_of_a_range_come_with_their_size(crane_machine: Machine) -> None:
    request = RecordingRequest(
        "Record 20 slow reversals of slew, with at least 5 % of its range between them.", (("backlash", "slew"),)
    )
    assert request_text(request, crane_machine) == (
        "Record 20 slow reversals of slew, with at least 5 % of its range (15°) between them."
    )
    both = RecordingRequest(
        "Record slew and telescope moving over half of its range, 20 s.", (("x", "slew"), ("x", "telescope"))
    )
    assert "half of its range (slew 149°, telescope 125\N{NARROW NO-BREAK SPACE}mm)" in request_text(both, crane_machine)
    assert request_text(RecordingRequest("Record poses.", (("x", "base"),)), crane_machine) == "Record poses."
