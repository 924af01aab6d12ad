"""What to record when effects tie."""

from __future__ import annotations

from sysid.gap.excitation import advice_on_tie
from sysid.machine import machine_from_files

AXES = "".join(
    f"""
[[axes]]
name = "{name}"
actuation = "{actuation}"
drives = "joint"
gain = 1.0
limits = [-1.0, 1.0]
"""
    for name, actuation in (("boom", "velocity"), ("pitch", "position"))
)
MACHINE = f'schema = 1\nname = "two"\nrate_hz = 50.0\n{AXES}'


def test_a_tie_names_the_rivals_and_what_shows_each_once() -> None:
    machine = machine_from_files({"machine.toml": MACHINE}, "test")
    text = advice_on_tie([("input_delay", "boom"), ("first_order_lag", "boom"), ("valve_hysteresis", "boom")], machine)
    names = "Dead time of boom or First-order lag of boom or Command hysteresis of boom"
    assert text.startswith(f"{names} cannot be distinguished.")
    assert text.count("sharp starts and stops of boom") == 1  # delay and lag ask for the same recording
    assert "slow reversals of the command of boom" in text


def test_a_servo_has_no_valve_in_the_text() -> None:
    machine = machine_from_files({"machine.toml": MACHINE}, "test")
    text = advice_on_tie([("first_order_lag", "pitch"), ("command_rate_limit", "pitch")], machine)
    assert text.startswith("Servo lag of pitch or Servo speed limit of pitch cannot be distinguished.")
    assert "valve" not in text.lower()
