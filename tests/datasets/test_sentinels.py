"""Numbers that stand for "no value": found where they lie apart from every measurement, missing where the recipe says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import run
from edge_machines import from_bytes, write_machine
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid.datasets import Store
from sysid.datasets.checks.flag import sentinels
from sysid.datasets.checks.run import check_plausibility

FREE = (-np.inf, np.inf)


def motion(rows: int, low: float, high: float) -> np.ndarray:
    return low + (high - low) * 0.5 * (1.0 - np.cos(0.05 * np.arange(rows)))


@settings(max_examples=examples(300), deadline=None)
@given(
    low=st.floats(-400.0, 400.0),
    width=st.floats(0.1, 360.0),
    number=st.sampled_from([-9999.0, 9999.0, -999.0, 32767.0, 65535.0, -32768.0, 1e6]),
    places=st.sets(st.integers(0, 199), min_size=3, max_size=60),
)
def test_the_numbers_of_loggers_are_found_beside_any_motion(low: float, width: float, number: float, places: set[int]) -> None:
    clean = motion(200, low, low + width)
    stamps = np.arange(200) * 10_000_000
    assert sentinels("boom.joint", clean, clean, stamps, FREE) == []
    values = clean.copy()
    values[sorted(places)] = number
    distance = min(abs(number - low), abs(number - low - width))
    found = sentinels("boom.joint", values, values, stamps, FREE)
    assert len(found) == (distance > max(width, abs(low), abs(low + width)))
    for flag in found:
        assert (flag.kind, flag.samples, flag.text.split()[0]) == ("sentinel", len(places), f"{number:.10g}")
        assert (flag.from_s, flag.to_s) == pytest.approx((0.01 * min(places), 0.01 * max(places)))


def test_two_numbers_of_one_logger() -> None:
    values = motion(100, -30.0, 40.0)
    values[[3, 4, 5]], values[[20, 40, 60, 61]] = -9999.0, 9999.0
    found = sentinels("ee.x", values, values, np.arange(100) * 10_000_000, FREE)
    assert [(flag.text.split()[0], flag.samples) for flag in found] == [("-9999", 3), ("9999", 4)]


@pytest.mark.parametrize(
    ("signal", "values", "ends"),
    [
        ("boom.command", np.where(np.arange(100) % 7 == 0, -9.0, 0.01 * np.arange(100)), FREE),  # commands jump
        ("boom.joint", np.where(np.arange(100) < 98, 0.01 * np.arange(100), 9999.0), FREE),  # twice: an outlier
        ("boom.joint", np.where(np.arange(100) % 5 == 0, 3.0, 0.01 * np.arange(100)), (-3.1, 3.1)),  # a place of the axis
        ("boom.joint", np.round(np.linspace(-1.0, 1.0, 100), 1), (-0.5, 0.5)),  # a coarse sensor
        ("boom.joint", np.where(np.arange(100) % 2 == 0, 1.0, 5.0), FREE),  # two states
        ("boom.speed", np.where(np.arange(100) < 50, 0.0, 0.5 + 0.001 * np.arange(100)), FREE),  # at rest
        ("boom.cylinder", np.where(np.arange(100) < 80, 15.05 + 0.003 * np.arange(100), 15.54), FREE),  # a plateau after a step
        ("boom.joint", np.full(100, np.nan), FREE),
        ("boom.joint", np.zeros(0), FREE),
    ],
)
def test_measurements_are_no_sentinels(signal: str, values: np.ndarray, ends: tuple[float, float]) -> None:
    assert sentinels(signal, values, values, np.arange(len(values)) * 10_000_000, ends) == []


def machine_with(folder: Path, number: float) -> Path:
    """Logs of a machine with ``number`` in eleven rows of a joint, and no recipe."""
    write_machine(from_bytes(b""), folder)
    path = folder / "logs/r0/log.csv"
    log = pd.read_csv(path)
    log.loc[100:110, "a0.joint"] = number
    log.to_csv(path, index=False)
    return path


RECIPE = """
schema = 1
[[streams]]
files = "log.csv"
[streams.signals]
"""


@pytest.mark.parametrize("number", [-9999.0, 65535.0])
def test_the_finding_names_the_line_that_removes_it(number: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "machine"
    path = machine_with(folder, number)
    assert run("--workspace", tmp_path / "ws", "ingest", folder) == 0
    said = capsys.readouterr().out
    assert f"a0.joint: {number:g} stands in 11 samples, apart from all others" in said
    assert f"write `missing = [{number:g}]` into the entry of the signal in the recipe" in said
    assert "mrad" not in said
    dataset = Store(tmp_path / "ws").load("edge")
    finding = next(finding for finding in check_plausibility(dataset) if finding.keys == ("a0.joint:sentinel",))
    assert finding.severity == "severe"
    # Followed to the letter, in a recipe of all columns:
    columns = [name for name in pd.read_csv(path).columns if name != "time"]
    lines = [
        f'"{name}" = {{ field = "{name}"{f", missing = [{number:g}]" if name == "a0.joint" else ""} }}' for name in columns
    ]
    recipe = folder / "recipe.toml"
    recipe.write_text(RECIPE + "\n".join(lines) + "\n")
    machine = next(folder.glob("machine.toml"), folder / "logs/machine.toml")
    assert run("--workspace", tmp_path / "ws", "ingest", folder / "logs", "--recipe", recipe, "--machine", machine) == 0
    said = capsys.readouterr().out
    assert f"a0.joint: 11 values {number:g} taken as missing" in said
    assert "sentinel" not in said
    table = Store(tmp_path / "ws").load("edge").recording("r0").table
    assert table["a0.joint"].abs().max() < 100.0


def test_a_number_among_static_poses_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "machine"
    path = machine_with(folder, -9999.0)
    log = pd.read_csv(path)
    columns = [name for name in log.columns if name != "time"]
    lines = [f'"{name}" = {{ field = "{name}" }}' for name in columns]
    recipe = RECIPE.replace("[[streams]]", '[recordings]\nposes = ["r0"]\n[[streams]]')
    (folder / "recipe.toml").write_text(recipe + "\n".join(lines) + "\n")
    held = log.iloc[np.repeat(np.arange(0, len(log), 40), 40)[: len(log)]].assign(time=log["time"].to_numpy())
    held.loc[held.index[100:111], "a0.joint"] = -9999.0
    held.to_csv(path, index=False)
    machine = next(folder.glob("machine.toml"), folder / "logs/machine.toml")
    command = ("ingest", folder / "logs", "--recipe", folder / "recipe.toml", "--machine", machine)
    assert run("--workspace", tmp_path / "ws", *command) == 0
    assert "a0.joint: -9999 stands in" in capsys.readouterr().out


def test_a_number_of_a_float_of_32_bits_is_found_by_its_decimals(tmp_path: Path) -> None:
    folder = tmp_path / "machine"
    path = machine_with(folder, float(np.float32(-999.9)))
    columns = [name for name in pd.read_csv(path).columns if name != "time"]
    lines = [f'"{name}" = {{ field = "{name}", missing = [-999.9] }}' for name in columns]
    (folder / "recipe.toml").write_text(RECIPE + "\n".join(lines) + "\n")
    machine = next(folder.glob("machine.toml"), folder / "logs/machine.toml")
    command = ("ingest", folder / "logs", "--recipe", folder / "recipe.toml", "--machine", machine)
    assert run("--workspace", tmp_path / "ws", *command) == 0
    assert Store(tmp_path / "ws").load("edge").recording("r0").table["a0.joint"].min() > -900.0
