"""What a repair changes in ``machine.toml``: a difference that applies, and leaves everything else as it was written."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.machine import KnownEffect, load_machine, machine_from_files
from sysid.plant import Plant, machine_difference, machine_text, nominal_plant

AUTOLOG = Path(__file__).parents[2] / "datasets/autolog/machine.toml"
HEAD = """schema = 1
name = "lift"
rate_hz = 50.0
[[axes]]
name = "boom"
actuation = "velocity"
drives = "joint"
gain = 0.03
limits = [-0.4, 1.2]
"""
LAG = (
    '# Tests of May.\n[[effects]]\nname = "first_order_lag"\ntarget = "boom"\nparameters = { time_constant = 0.06 } # by eye\n'
)
DEADBAND = KnownEffect("valve_deadband", "boom", {"positive": 0.1199987234, "negative": 0.1})
SLOWER = KnownEffect("first_order_lag", "boom", {"time_constant": 0.17})


def lift(text: str) -> Plant:
    return nominal_plant(machine_from_files({"machine.toml": text}, "lift"))


def applied(text: str, difference: str, folder: Path) -> str:
    """What ``git apply`` makes of the difference, as a person would."""
    (folder / "machine.toml").write_text(text, "utf-8")
    (folder / "machine.diff").write_text(difference, "utf-8")
    subprocess.run(["git", "apply", "-p0", "machine.diff"], cwd=folder, check=True, capture_output=True)
    return (folder / "machine.toml").read_text("utf-8")


def same_effects(one: Plant, other: Plant) -> None:
    np.testing.assert_allclose(one.vector(), other.vector(), rtol=1e-5, atol=1e-300)
    assert {(e.name, e.target, e.side) for e in one.effects} == {(e.name, e.target, e.side) for e in other.effects}


def test_only_the_line_of_a_changed_value_is_new() -> None:
    before = lift(HEAD + LAG + "[noise]\n")
    assert machine_difference(before, before.with_effect(SLOWER)) == (
        '--- machine.toml\n+++ machine.toml\n@@ -11,5 +11,5 @@\n [[effects]]\n name = "first_order_lag"\n target = "boom"\n'
        "-parameters = { time_constant = 0.06 } # by eye\n+parameters = { time_constant = 0.17 } # by eye\n [noise]\n"
    )


def test_the_difference_applies_to_the_shipped_machine(tmp_path: Path) -> None:
    before = nominal_plant(load_machine(AUTOLOG))
    after = (
        before.with_effect(DEADBAND)
        .with_effect(KnownEffect("backlash", "slew", {"width": 0.0105}, "structure"))
        .with_effect(
            KnownEffect("base_misalignment", "base", {"translation": [0.01, 0.0, -2e-7], "rotation": [0.0, 1e-3, 0.0]})
        )
        .with_effect(KnownEffect("first_order_lag", "slew", {"time_constant": 0.0712345678}))
        .without_effect("valve_deadband", "telescope")
    )
    text = applied(before.machine.text, machine_difference(before, after), tmp_path)
    files = {**after.machine.files(), "machine.toml": text}
    same_effects(nominal_plant(machine_from_files(files, "patched")), after)
    assert "# What the nominal simulation knows from earlier step tests." in text
    assert not [line for line in before.machine.text.splitlines() if line.startswith("#") and line not in text]


@pytest.mark.parametrize(
    "text",
    [
        HEAD,
        HEAD.rstrip("\n"),
        HEAD + LAG,
        (HEAD + LAG).rstrip("\n"),
        HEAD + LAG + "\n# The data sheet.\n[noise]\n",
        HEAD + '[[effects]]\nname = "first_order_lag"\ntarget = "boom"\n[effects.parameters]\ntime_constant = 0.06\n[noise]\n',
        HEAD + '[[effects]]\nname = "first_order_lag"\ntarget = "boom"\nparameters.time_constant = 0.06\n',
        HEAD.replace(
            "[[axes]]", 'effects = [{name = "first_order_lag", target = "boom", parameters = {time_constant = 0.06}}]\n[[axes]]'
        ),
    ],
    ids=["none", "none, no end of line", "last", "last, no end of line", "noise behind", "sub-table", "dotted", "inline"],
)
@pytest.mark.parametrize(
    "new", [(DEADBAND,), (SLOWER, DEADBAND), (SLOWER,), ()], ids=["one more", "both", "another value", "gone"]
)
def test_every_layout(text: str, new: tuple[KnownEffect, ...], tmp_path: Path) -> None:
    before = lift(text)
    after = before if new else before.without_effect("first_order_lag", "boom")
    for effect in new:
        after = after.with_effect(effect)
    difference, made = machine_difference(before, after), machine_text(after)
    if "effects = [" in text:
        assert made is None
        assert "[[effects]]" in difference, "there is no line to change: the tables that stand for it"
        return
    assert made is not None
    same_effects(lift(made), after)
    assert (difference == "") == (not new and not before.effects)
    if difference:
        assert applied(text, difference, tmp_path) == made


def test_without_a_change_there_is_no_difference() -> None:
    plant = nominal_plant(load_machine(AUTOLOG))
    assert machine_text(plant) == plant.machine.text
    assert machine_difference(plant, plant) == ""


@given(st.floats(1e-6, 0.9), st.floats(1e-6, 0.9), st.booleans())
def test_values_come_back_to_six_digits(positive: float, negative: float, lag: bool) -> None:
    after = lift(HEAD + (LAG if lag else "")).with_effect(
        KnownEffect("valve_deadband", "boom", {"positive": positive, "negative": negative})
    )
    made = machine_text(after)
    assert made is not None
    same_effects(lift(made), after)
