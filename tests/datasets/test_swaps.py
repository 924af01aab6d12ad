"""Exchanged columns: all pairs at once as one by one, and machines of many axes."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from sysid.datasets.checks.run import check_plausibility
from sysid.datasets.quality.responses import correlation, strengths
from sysid.datasets.recording import Dataset, Recording
from sysid.machine import Machine, machine_from_files


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def test_correlations_of_all_pairs_are_those_of_each(rng: np.random.Generator) -> None:
    commands, answers = rng.normal(size=(400, 5)).cumsum(axis=0), rng.normal(size=(400, 4)).cumsum(axis=0)
    answers[:, 1] = np.roll(commands[:, 2], 7) + 1e6
    commands[:, 3], answers[:, 2] = 2.0, 0.0
    commands[rng.random(commands.shape) < 0.1] = np.nan
    answers[200:260] = np.nan
    expected = [[abs(correlation(u, y, 30)) for y in answers.T] for u in commands.T]
    np.testing.assert_allclose(strengths(commands, answers, 30), expected, atol=1e-6)


def machine(axes: int) -> Machine:
    tables = "".join(
        f'[[axes]]\nname = "a{k}"\nactuation = "position"\ndrives = "joint"\njoint_type = "revolute"\n' for k in range(axes)
    )
    return machine_from_files({"machine.toml": f'schema = 1\nname = "m"\nrate_hz = 20.0\n{tables}'}, "here")


def recording(order: list[int], rng: np.random.Generator) -> Recording:
    """Each axis answers the command of the one in ``order``, a tenth of a second later."""
    commands = np.array([np.sin((0.5 + 0.37 * k) * np.arange(800) / 20.0 + k) for k in range(len(order))])
    columns = {"time": np.arange(800) / 20.0}
    for axis, source in enumerate(order):
        columns[f"a{axis}.command"] = commands[axis]
        columns[f"a{axis}.joint"] = np.roll(commands[source], 2) + 1e-3 * rng.normal(size=800)
    return Recording("run", pd.DataFrame(columns), 20.0)


@pytest.mark.parametrize("order", [[1, 0, 2, 3, 4], [0, 3, 1, 2, 4]])
def test_two_or_three_exchanged_columns_are_named_among_others(order: list[int], rng: np.random.Generator) -> None:
    found = check_plausibility(Dataset.of(machine(5), [recording(order, rng)]))
    keys = {key for finding in found for key in finding.keys if key.endswith(":exchanged")}
    assert keys == {f"a{axis}.joint:exchanged" for axis, source in enumerate(order) if axis != source}


def test_more_axes_than_are_compared_are_said(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid.datasets.checks.columns.MOST_COMPARED", 3)
    found = check_plausibility(Dataset.of(machine(5), [recording([1, 2, 3, 4, 0], rng)]))
    notices = [finding for finding in found if finding.keys == ("machine:exchanged",)]
    assert [finding.severity for finding in notices] == ["notice"]
    assert notices[0].lines == ("5 axes do not follow their own command; expected at most 3 to search for exchanged columns",)


@pytest.mark.parametrize("rows", [1, 2, 5, 29, 31])
def test_series_shorter_than_the_longest_delay_have_no_strength_there(rows: int) -> None:
    values = np.random.default_rng(1).standard_normal((rows, 2))
    assert np.isfinite(strengths(values, values, 30)).all()
