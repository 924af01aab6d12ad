"""Differences between the effects of two plants."""

from __future__ import annotations

from typing import Any

from sysid.registry.effect_changes import EffectChange, effect_changes


def lineage(*effects: dict[str, Any]) -> dict[str, Any]:
    return {"effects": list(effects)}


BACKLASH = {"name": "backlash", "target": "slew", "parameters": {"width": 0.01}, "interval95": {"width": [0.009, 0.011]}}


def test_added_removed_and_changed_parameters_are_listed_once() -> None:
    wider = {**BACKLASH, "parameters": {"width": 0.02}, "interval95": {"width": [0.019, 0.021]}}
    assert effect_changes({}, lineage(BACKLASH)) == (EffectChange("backlash", "slew", "width", None, 0.01, (0.009, 0.011)),)
    assert effect_changes(lineage(BACKLASH), {}) == (EffectChange("backlash", "slew", "width", 0.01, None, (0.009, 0.011)),)
    assert effect_changes(lineage(BACKLASH), lineage(wider)) == (
        EffectChange("backlash", "slew", "width", 0.01, 0.02, (0.019, 0.021)),
    )
    assert effect_changes(lineage(BACKLASH), lineage(BACKLASH)) == ()


def test_the_same_effect_on_another_axis_is_another_one() -> None:
    other = {**BACKLASH, "target": "boom"}
    assert [change.target for change in effect_changes(lineage(BACKLASH), lineage(other))] == ["boom", "slew"]


def test_an_effect_without_parameters_or_intervals_counts() -> None:
    assert effect_changes({}, lineage({"name": "a", "target": "b"})) == (EffectChange("a", "b", "", None, "", ()),)
