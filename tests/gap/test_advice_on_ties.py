"""What to record when effects tie."""

from __future__ import annotations

from sysid.gap.excitation import advice_on_tie


def test_a_tie_names_the_rivals_and_what_shows_each_once() -> None:
    text = advice_on_tie([("input_delay", "boom"), ("first_order_lag", "boom"), ("valve_hysteresis", "boom")])
    names = "input_delay on boom or first_order_lag on boom or valve_hysteresis on boom"
    assert text.startswith(f"{names} cannot be distinguished.")
    assert text.count("sharp starts and stops of boom") == 1  # delay and lag ask for the same recording
    assert "slow reversals of the command of boom" in text
