"""Console of a gap result: nothing that is written is left out, and the texts fit an 80-column terminal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.cli.gap_tables import plain_reason, show_gap
from sysid.cli.output import WIDTH, Printer
from sysid.datasets import Dataset
from sysid.gap import GapResult
from sysid.gap.reasons import Reason
from sysid.gap.result import AxisDelay, Excitation, Gap, NamedEffect, NearMissResult
from sysid.gap.stored_result import load_gap, save_gap
from sysid.gap.written import axis_delays, written_effects
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import nominal_plant
from sysid.reports.result_figures import next_steps

AXES = "".join(
    f'[[axes]]\nname = "{name}"\nactuation = "{actuation}"\ndrives = "joint"\ngain = 1.0\nlimits = [-1.0, 1.0]\n'
    for name, actuation in (("boom", "velocity"), ("pitch", "position"))
)
KNOWN = '[[effects]]\nname = "first_order_lag"\ntarget = "boom"\nparameters = { time_constant = 0.06 }\n'
MACHINE = machine_from_files({"machine.toml": f'schema = 1\nname = "two"\nrate_hz = 50.0\n{AXES}{KNOWN}'}, "test")
DATASET = replace(Dataset.of(MACHINE, []), units={"boom.joint": "rad", "pitch.joint": "rad"})
DELAY = NamedEffect("input_delay", "pitch", {"delay": 0.067}, {"delay": (0.06, 0.07)}, 0.02)
NOTHING = Gap({}, {}, {})


def result(**values: object) -> GapResult:
    plain = GapResult("two@1", "", "", "named", (), (), (), (), NOTHING, NOTHING, (), ("held",), 1.0)
    return replace(plain, **values)  # type: ignore[arg-type]


def repaired_example() -> GapResult:
    before = nominal_plant(MACHINE)
    after = before
    for name, target, parameters in (
        ("first_order_lag", "boom", {"time_constant": 0.1}),
        ("input_delay", "pitch", {"delay": 0.067}),
        ("first_order_lag", "pitch", {"time_constant": 0.03}),
        ("backlash", "boom", {"width": 0.01}),
    ):
        after = after.with_effect(KnownEffect(name, target, parameters))
    misses = (NearMissResult("first_order_lag", "pitch", "command stage of pitch", {}, {}, 3.0, Reason.LITTLE),)
    written = written_effects(before, after, [DELAY], [(("backlash", "boom"), ("stiction", "boom"))], misses, {})
    return result(effects=(DELAY,), written=written, near_misses=misses, delays=axis_delays(before, after))


def test_every_difference_of_the_plants_is_written_with_its_kind() -> None:
    found = {(item.name, item.target): item for item in repaired_example().written}
    assert {key: item.kind for key, item in found.items()} == {
        ("input_delay", "pitch"): "named",
        ("backlash", "boom"): "tied",
        ("first_order_lag", "boom"): "adjusted",
        ("first_order_lag", "pitch"): "adjusted",
    }
    assert found["first_order_lag", "boom"].before == {"time_constant": 0.06}, "a known value that changes"
    assert found["first_order_lag", "pitch"].why == Reason.LITTLE
    assert found["input_delay", "pitch"].interval95 == {"delay": (0.06, 0.07)}


def test_what_the_plant_had_before_is_not_written() -> None:
    before = nominal_plant(MACHINE)
    assert written_effects(before, before, [], [], (), {}) == ()
    assert axis_delays(before, before) == (AxisDelay("boom", (0.0, 0.0), (0.06, 0.06)),)


def test_the_console_has_a_row_for_each_and_the_total_delay(capsys: pytest.CaptureFixture[str]) -> None:
    show_gap(Printer(), repaired_example(), DATASET)
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "The repair has 4 effects:" in lines
    assert any(line.startswith("Dead time of pitch delay 67.0 ms 60.0 to 70.0 ms 2 % named") for line in lines), lines
    assert any(line.startswith("First-order lag of boom time constant 100 ms (was 60.0 ms)") for line in lines)
    assert any(line.startswith("Servo lag of pitch") and line.endswith("no name") for line in lines)
    assert any(line.startswith("Backlash of boom") and line.endswith("one of a tie") for line in lines)
    assert "pitch 0 ms → 67.0 ms 0 ms → 30.0 ms 0 ms → 97.0 ms" in lines
    assert "boom 0 ms 60.0 ms → 100 ms 60.0 ms → 100 ms" in lines
    assert sum(line.startswith("Share: ") for line in lines) == 1


def test_near_misses_are_listed_with_what_they_lack(capsys: pytest.CaptureFixture[str]) -> None:
    def miss(name: str, distance: float) -> NearMissResult:
        return NearMissResult(name, "pitch", "s", {"delay": 0.03}, {"delay": (0.01, 0.05)}, distance, Reason.REPLACED)

    found = result(near_misses=(miss("input_delay", 4.0), miss("first_order_lag", 1.0)))
    show_gap(Printer(), found, DATASET)
    short = capsys.readouterr().out
    assert "Dead time of pitch, delay 30.0 ms ± 20 ms: the simulation predicts as well" in short.replace("\u202f", " ")
    assert "Servo lag" not in short, "its value is within the noise"
    assert "(1 more, less clear: --verbose)" in short
    show_gap(Printer(), found, DATASET, verbose=True)
    assert "Servo lag of pitch" in capsys.readouterr().out


def test_next_steps_are_grouped_over_axes_and_short(capsys: pytest.CaptureFixture[str]) -> None:
    names = [f"axis_with_a_long_name_{number}" for number in range(12)]
    lacking = [Excitation("temperature_drift", name, False, 3.0, 60.0, "s of motion in one recording") for name in names]
    lacking += [Excitation("backlash", "pitch", False, 2.0, 8.0, "reversals")]
    lacking += [Excitation(name, "boom", False, 0.0, 0.1, "% of its range") for name in ("gain_error", "stiction")]
    lacking += [Excitation("input_delay", "pitch", False, 2.0, 10.0, "command changes")]
    found = result(excitation=tuple(lacking), ambiguous=((("gain_error", "boom"), ("gain_curve", "boom")),))
    steps = next_steps(found, DATASET)
    assert len(steps) == 5, "one motion for twelve axes, one tie, one axis that stood still, two of pitch"
    assert "Wrong speed gain of boom or Nonlinear gain of boom" in steps[0]
    assert sum(all(name in step for name in names) for step in steps) == 1
    show_gap(Printer(), found, DATASET)
    out = capsys.readouterr().out.partition("Next, the most useful first:")[2].splitlines()[1:]
    assert all(len(line) <= WIDTH for line in out)
    assert [line[:5] for line in out if line[2:3].isdigit()] == ["  1. ", "  2. ", "  3. "]
    assert out[-1] == "  (2 more: --verbose)"


@given(
    st.text(st.characters(codec="ascii", categories=["L", "N", "P", "Zs"]), max_size=900), st.sampled_from(["", "  ", "  1. "])
)
def test_a_sentence_is_whole_in_lines_of_80_columns(text: str, bullet: str) -> None:
    lines: list[str] = []
    Printer.entry(SimpleNamespace(line=lines.append), text, bullet)  # type: ignore[arg-type]
    assert all(len(line) <= WIDTH for line in lines)
    assert "".join("".join(lines).split()) == "".join((bullet + text if lines else "").split())


def test_every_reason_of_the_decision_has_plain_words() -> None:
    for why in Reason:
        assert "equivalence" not in plain_reason(why)
    for why in (Reason.NOT_EXCITED, Reason.LITTLE, Reason.LOST, Reason.REPLACED, Reason.REPAIRS):
        assert not plain_reason(why).startswith("a ")
    assert plain_reason("something new") == "something new"


def test_the_archive_keeps_them(tmp_path: Path) -> None:
    found = repaired_example()
    save_gap(tmp_path / "gap", found)
    again = load_gap(tmp_path / "gap")
    assert again is not None
    assert (again.delays, [w.kind for w in again.written]) == (found.delays, [w.kind for w in found.written])
    assert again.written[0] == found.written[0]
    assert again.near_misses == found.near_misses


def lines_of(capsys: pytest.CaptureFixture[str], columns: int, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setenv("COLUMNS", str(columns))
    header = ("name", "made from", "share")
    Printer().table(header, [("autolog-actuator@1", "three recordings of a crane", "12.5"), ("b", "", "7")], (2,))
    return capsys.readouterr().out.splitlines()


@pytest.mark.parametrize("columns", [200, 44, 40, 20])
def test_a_table_in_a_pipe_takes_the_width_of_columns_and_breaks_no_word(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, columns: int
) -> None:
    lines = lines_of(capsys, columns, monkeypatch)
    assert max(map(len, lines)) <= max(columns, len("   autolog-actuator@1"))
    words = " ".join(lines).split()
    for word in ("autolog-actuator@1", "three", "recordings", "crane", "12.5", "7"):
        assert word in words


def test_a_table_that_is_too_wide_lists_its_cells_with_their_titles(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = [line.strip() for line in lines_of(capsys, 28, monkeypatch)]
    assert lines[lines.index("name: autolog-actuator@1") + 1 :][:3] == [
        "made from: three",
        "recordings of a crane",
        "share: 12.5",
    ]
    assert lines[lines.index("name: b") + 1] == "share: 7", "an empty cell has no line"


def test_columns_are_wrapped_before_the_gaps_are_lost(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = lines_of(capsys, 44, monkeypatch)
    row = next(line for line in lines if "autolog-actuator@1" in line)
    assert row.rstrip().endswith("12.5")
    assert "three" in row
    assert lines[lines.index(row) + 1].split()[-1] in ("a", "crane", "of", "recordings")
