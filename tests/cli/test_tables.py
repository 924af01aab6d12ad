"""Tables of the verbs: what changed between two simulations."""

from __future__ import annotations

from sysid.cli.tables import effects_difference
from sysid.machine import KnownEffect

LAG = KnownEffect("first_order_lag", "boom", {"time_constant": 0.06})
DEADBAND = KnownEffect("valve_deadband", "boom", {"positive": 0.12, "negative": 0.1})


def test_a_new_effect_is_added_whole_and_a_changed_one_line_by_line() -> None:
    slower = KnownEffect("first_order_lag", "boom", {"time_constant": 0.17})
    assert effects_difference((LAG,), (DEADBAND, slower)) == [
        "  [[effects]]",
        '  name = "first_order_lag"',
        '  target = "boom"',
        "- parameters = { time_constant = 0.06 }",
        "+ parameters = { time_constant = 0.17 }",
        "",
        "+ [[effects]]",
        '+ name = "valve_deadband"',
        '+ target = "boom"',
        "+ parameters = { positive = 0.12, negative = 0.1 }",
    ]


def test_what_stays_is_not_shown_and_what_goes_is() -> None:
    assert effects_difference((LAG, DEADBAND), (DEADBAND, LAG)) == []
    assert [line[0] for line in effects_difference((LAG,), ())] == ["-"] * 4


def test_the_two_sides_of_a_play_are_two_effects() -> None:
    drive, structure = (KnownEffect("backlash", "slew", {"width": 0.01}, side) for side in ("drive", "structure"))
    lines = effects_difference((drive,), (drive, structure))
    assert '+ side = "structure"' in lines
    assert not any(line.startswith("-") for line in lines)
