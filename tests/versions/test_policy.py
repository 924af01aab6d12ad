"""Policies are strict, units count, and a refusal says which line failed by how much."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from crane_data import dataset
from version_data import actuator, forward

from sysid.errors import SettingsError
from sysid.registry import Check
from sysid.validate import ValidationReport, validate_model
from sysid.versions import PromotionPolicy, load_policy, policy_checks


@pytest.fixture(scope="module")
def exact() -> ValidationReport:
    return in_motion(validate_model(actuator("boom"), dataset(), name="crane-actuator@1"))


@pytest.fixture(scope="module")
def off() -> ValidationReport:
    """Its joint is off by 2 mrad; the other direction is the same."""
    return in_motion(validate_model(actuator("boom", off=0.002), dataset(), name="crane-actuator@2"))


def in_motion(report: ValidationReport) -> ValidationReport:
    return replace(report, outputs=tuple(entry for entry in report.outputs if entry.rows == "motion"))


def degrees(angle: float) -> str:
    return f"{math.degrees(angle):.3g}°"


def policy(tmp_path: Path, text: str) -> PromotionPolicy:
    path = tmp_path / "policy.toml"
    path.write_text(f"schema = 1\n{text}")
    return load_policy(path)


def failed(checks: tuple[Check, ...]) -> list[str]:
    return [check.text for check in checks if check.status == "failed"]


def test_a_limit_in_any_unit(tmp_path: Path, off: ValidationReport) -> None:
    largest = off.output("boom.joint").metrics.max
    passes = policy(tmp_path, f'[actuator.limits]\n"boom.joint" = {{max = "{1.01 * largest * 57.29578} deg"}}')
    assert [check.status for check in policy_checks(passes, off)] == ["passed", "left out"]
    fails = policy(tmp_path, '[actuator.limits]\n"*.joint" = {max = "1 mrad", rows = "motion"}')
    (text,) = failed(policy_checks(fails, off))
    assert text == f"boom.joint in motion: max {degrees(largest)}, {degrees(largest - 1e-3)} above the {degrees(1e-3)} allowed"


def test_not_worse_than_the_champion(exact: ValidationReport, off: ValidationReport) -> None:
    texts = failed(policy_checks(PromotionPolicy(), off, exact))
    assert len(texts) == 2, "rmse and 95 % of the joint; the cylinder is as it was"
    ratio = off.output("boom.joint").metrics.rmse / exact.output("boom.joint").metrics.rmse
    assert f"{100.0 * (ratio - 1.0):.1f} % above the " in texts[0]
    assert texts[0].endswith(" of crane-actuator@1; 5 % allowed")
    assert failed(policy_checks(PromotionPolicy(), exact, off)) == []
    assert failed(policy_checks(PromotionPolicy(), exact, exact)) == []
    wide = replace(PromotionPolicy(), actuator=replace(PromotionPolicy().actuator, margin=ratio))
    assert failed(policy_checks(wide, off, exact)) == []


def test_an_output_that_is_gone(exact: ValidationReport) -> None:
    fewer = replace(exact, outputs=exact.outputs[:1], model="crane-actuator@3")
    assert failed(policy_checks(PromotionPolicy(), fewer, exact)) == [
        "boom.cylinder in motion: crane-actuator@1 predicts it, this version does not"
    ]
    assert failed(policy_checks(PromotionPolicy(), exact, fewer)) == []


def test_simple_models(tmp_path: Path, exact: ValidationReport, off: ValidationReport) -> None:
    rules = policy(tmp_path, "[actuator]\nbaselines = true\nmargin = 0.3\n")
    assert failed(policy_checks(rules, exact)) == []
    assert "of the best simple model (" in failed(policy_checks(rules, off))[0]


def test_without_a_champion_the_default_asks_nothing(exact: ValidationReport) -> None:
    (check,) = policy_checks(PromotionPolicy(), exact)
    assert (check.status, check.text) == ("left out", "nothing of this name was promoted before")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[actuators]", r"unknown key 'actuators'; expected 'actuator'\?"),
        ("[actuator]\nmargins = 1", r"unknown key 'actuator\.margins'; expected 'margin'\?"),
        ("[actuator]\nmargin = -0.1", r"actuator\.margin: -0\.1; expected a share from 0 on"),
        ('[actuator]\nnot_worse = ["rms"]', r"not_worse\[0\] = 'rms'"),
        ('[actuator.limits]\n"boom.joint" = {maxi = "1 mrad"}', r"unknown key .*maxi'; expected 'max'\?"),
        (
            '[actuator.limits]\n"boom.joint" = {rows = "motion"}',
            r"'boom\.joint': no figure; expected at least one of rmse, max",
        ),
        ('[actuator.limits]\n"boom.joint" = {max = 1}', r"max: 1.*expected a positive number with its unit, as in '15 mm'"),
        ('[actuator.limits]\n"boom.joint" = {max = "-1 mrad"}', r"'-1 mrad'; expected a positive number with its unit"),
        ('[actuator.limits]\n"boom.joint" = {max = "0 mrad"}', r"'0 mrad'; expected a positive number with its unit"),
        ('[actuator.limits]\n"boom.joint" = {max = "1.2.3 mm"}', r"'1\.2\.3 mm'; expected a positive number"),
        ('[actuator.limits]\n"boom.joint" = {max = "1 furlog"}', r"unknown unit 'furlog'"),
    ],
)
def test_mistakes_in_the_file(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        policy(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('"bom.joint" = {max = "1 mrad"}', r"actuator\.limits\.'bom\.joint': no such output; expected 'boom\.joint'\?"),
        ('"boom.joint" = {max = "1 mm"}', r"'boom\.joint'\.max: '1 mm'; expected a quantity in rad, as in '5 mrad'"),
        ('"boom.joint" = {max = "1 mrad", rows = "poses"}', r"rows: no held-out poses of it; expected motion, or none named"),
    ],
)
def test_a_policy_that_does_not_fit_the_network(tmp_path: Path, exact: ValidationReport, text: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        policy_checks(policy(tmp_path, f"[actuator.limits]\n{text}"), exact)


def test_kinds_have_rules_of_their_own(tmp_path: Path) -> None:
    rules = policy(tmp_path, '[actuator.limits]\n"boom.joint" = {max = "1 mrad"}\n[forward]\nnot_worse = []\n')
    report = validate_model(forward(), dataset())
    with pytest.raises(SettingsError, match=r"policy: forward: no condition; expected limits, not_worse or baselines"):
        policy_checks(rules, report)
