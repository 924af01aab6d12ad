"""A gain that nobody states is no property of the machine: recordings are compared with each other, and nothing is named."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sysid.datasets import Dataset, ingest
from sysid.datasets.checks.finding import Finding
from sysid.datasets.checks.run import check_plausibility
from sysid.gap import find_gap
from sysid.machine import load_machine
from sysid.plant import nominal_plant

MACHINE = (
    'schema = 1\nname = "press"\nrate_hz = 50.0\n[[axes]]\nname = "ram"\nactuation = "velocity"\ndrives = "joint"\n'
    'joint_type = "prismatic"\n'
)
GAIN, LATE = 0.1, 6


def recorded(folder: Path, factors: tuple[float, ...], machine: str = MACHINE) -> Dataset:
    """Recordings of an axis of :data:`GAIN` m/s that follows after :data:`LATE` rows, each read too large by its factor."""
    folder.mkdir()
    (folder / "machine.toml").write_text(machine)
    for k, factor in enumerate(factors):
        rng = np.random.default_rng(k)
        command = np.repeat(rng.uniform(-1.0, 1.0, 40), 50)
        acts = np.concatenate([np.zeros(LATE), command[:-LATE]])
        place = np.concatenate([[0.0], np.cumsum(GAIN * acts)[:-1] / 50.0]) + rng.normal(0.0, 1e-4, len(command))
        (folder / f"logs/r{k}").mkdir(parents=True)
        table = {"time": np.arange(len(command)) / 50.0, "ram.command": command, "ram.joint [m]": factor * place}
        pd.DataFrame(table).to_csv(folder / f"logs/r{k}/log.csv", index=False)
    return ingest(folder / "logs", folder / "ws", machine=folder / "machine.toml")


def test_a_gain_that_is_left_out_is_an_estimate(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(MACHINE)
    assert load_machine(tmp_path / "machine.toml").axis("ram").estimated == ("gain",)
    (tmp_path / "machine.toml").write_text(f"{MACHINE}gain = 1.0\n")
    assert load_machine(tmp_path / "machine.toml").axis("ram").estimated == ()


@pytest.mark.parametrize(("factors", "wrong"), [((1.0, 1.0, 0.1, 1.0), "r2"), ((10.0, 1.0, 1.0), "r0"), ((1.0, 0.1), "r1")])
def test_a_recording_in_another_unit_differs_from_the_others(tmp_path: Path, factors: tuple[float, ...], wrong: str) -> None:
    findings = {finding.keys: finding for finding in check_plausibility(recorded(tmp_path / "press", factors))}
    finding = findings["ram:response",]
    assert (finding.severity, finding.recordings) == ("severe", (wrong,))
    assert "as in the other recordings" in finding.evidence[0].text
    assert "ram.joint is in" in finding.causes[0].text
    assert advised(findings["ram:gain",]) == pytest.approx(GAIN, rel=0.05)


def advised(finding: Finding) -> float:
    """The gain that the remedy of a finding says to write."""
    found = re.search(r"`gain = ([\d.]+)` and `estimated = \[\"gain\"\]`", finding.causes[0].remedy)
    assert found is not None
    return float(found[1])


def test_recordings_that_agree_blame_no_key_that_is_not_there(tmp_path: Path) -> None:
    (finding,) = check_plausibility(recorded(tmp_path / "press", (1.0, 1.0, 1.0)))
    assert (finding.keys, finding.severity) == (("ram:gain",), "severe")
    assert finding.causes[0].text == "`gain` in machine.toml of axis ram is left out, or an estimate"


@pytest.mark.parametrize("gain", [pytest.param(0.3, marks=pytest.mark.slow), None])
def test_the_gap_corrects_the_gain_and_names_the_effect(tmp_path: Path, gain: float | None) -> None:
    """Also after the remedy for a gain that is left out."""
    if gain is None:
        gain = advised(check_plausibility(recorded(tmp_path / "before", (1.0, 1.0, 1.0)))[0])
    stated = recorded(tmp_path / "press", (1.0, 1.0, 1.0), f'{MACHINE}gain = {gain}\nestimated = ["gain"]\n')
    assert all(finding.severity == "notice" for finding in check_plausibility(stated))
    found = find_gap(stated, nominal_plant(stated.machine))
    assert [(effect.name, effect.target) for effect in found.effects] == [("input_delay", "ram")]
    assert found.effects[0].parameters["delay"] == pytest.approx(LATE / 50.0, abs=1e-3)
    (ratio,) = (item.parameters["ratio"] for item in found.written if item.name == "gain_error")
    assert gain * ratio == pytest.approx(GAIN, rel=1e-3)
