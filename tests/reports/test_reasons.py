"""Why effects were named and others not, in words."""

from __future__ import annotations

import math

from sysid.gap.result import Alternative, ComparedModel, NamedEffect
from sysid.machine import Machine
from sysid.reports.picture import part_of, place_text
from sysid.reports.words import confidence, label_of, outcome, rejected, relative_width


def row(*effects: str, unseen: float, verdict: str = "survives") -> ComparedModel:
    return ComparedModel("command", "boom", effects, {}, unseen, unseen, 50.0, verdict)


ROWS = (
    row("gain_error(boom)", "valve_deadband(boom)", unseen=1.02),
    row("valve_deadband(boom)", unseen=1.0),
    row("gain_curve(boom)", unseen=12.4, verdict="3140 ± 80 nats worse"),
    row("stiction(boom)", unseen=1.3, verdict="210 ± 12 nats worse"),
    row("valve_hysteresis(boom)", unseen=1.01),
    row("backlash(boom, drive)", unseen=math.nan),
)
NAMED = NamedEffect(
    "valve_deadband",
    "boom",
    {"positive": 0.12, "negative": 0.10},
    {"positive": (0.117, 0.123), "negative": (0.095, 0.105)},
    0.8,
    tuple(
        Alternative(name, "boom", f"predicts {nats} nats worse")
        for name, nats in (("gain_curve", "3140 ± 80"), ("stiction", "210 ± 12"), ("valve_hysteresis", "9 ± 3"))
    ),
)


def test_labels_of_candidates() -> None:
    assert label_of("backlash(slew, drive)") == ("backlash", "slew", "drive")
    assert label_of("sensor_bias(boom.cylinder)") == ("sensor_bias", "boom.cylinder", "")
    assert label_of("valve_deadband(boom) [positive, negative]") == ("valve_deadband", "boom", "positive, negative")


def test_the_nearest_rival_comes_first_and_each_says_what_it_left() -> None:
    found = rejected(NAMED, ROWS)
    assert [item.title for item in found] == ["Spool hysteresis", "Stiction", "Curved valve gain"]
    assert [item.times for item in found] == [1.01, 1.3, 12.4]
    assert found[1].why == "predicts 210 ± 12 nats worse"


def test_confidence_counts_rivals_and_gives_the_widest_interval() -> None:
    first, second = confidence(NAMED, ROWS)
    assert first == "3 alternatives were tested."
    assert second == "Its values are known to within ±5.0\N{NARROW NO-BREAK SPACE}%."
    without = tuple(r for r in ROWS if "hysteresis" not in r.effects[0])
    assert "the best, stiction, leaves 1.3" in confidence(NAMED, without)[0]


def test_no_percentage_for_a_value_near_zero_or_a_vector() -> None:
    near_zero = NamedEffect("sensor_bias", "boom.joint", {"bias": 0.001}, {"bias": (-0.01, 0.012)}, 0.5)
    vector = NamedEffect("base_misalignment", "base", {"rotation": (0.1, 0.0, 0.0)}, {"rotation": ((0,) * 3, (1,) * 3)}, 0.5)
    assert math.isnan(relative_width(near_zero))
    assert math.isnan(relative_width(vector))
    assert confidence(vector, ()) == []


def test_what_became_of_a_fit() -> None:
    named = [("valve_deadband", "boom")]
    assert outcome(row("valve_deadband(boom)", unseen=1.01), 1.0, named) == ("explains it", True)
    assert outcome(ROWS[2], 1.0, named) == ("predicts 3140 ± 80 nats worse", False)
    assert outcome(row("stiction(boom)", unseen=1.3), 1.0, named) == (
        "leaves 30\N{NARROW NO-BREAK SPACE}% more error than the best",
        False,
    )
    assert outcome(ROWS[4], 1.0, named) == ("about as good, with more effects", False)
    assert outcome(ROWS[5], 1.0, named) == ("could not be fitted", False)


def test_places_in_words(crane_machine: Machine) -> None:
    assert part_of("valve_deadband", "boom", crane_machine) == "valve"
    assert part_of("internal_leakage", "boom", crane_machine) == "cylinder"
    assert part_of("stiction", "slew", crane_machine) == "drive", "the slew has no cylinder"
    assert part_of("stiction", "boom", crane_machine, ("breakaway", "release")) == "cylinder", "seals"
    assert part_of("stiction", "boom", crane_machine, ("spool_breakaway", "spool_release")) == "valve"
    assert place_text("valve", "boom") == "valve of the boom"
    assert place_text("sensor", "boom.cylinder") == "sensor boom cylinder"
    assert place_text("link", "ee") == "links up to the tip"
    assert place_text("clock", "mocap") == "clock of mocap"


def test_a_parameter_that_is_not_determined_has_no_width() -> None:
    values, intervals = {"breakaway": 0.1, "release": 0.004}, {"breakaway": (0.099, 0.101), "release": (0.0, 0.03)}
    known = NamedEffect("stiction", "boom", values, intervals, 0.8, undetermined=("release",))
    assert math.isclose(relative_width(known), 0.01)
    assert "Its value is known to within" in confidence(known, ())[-1]
