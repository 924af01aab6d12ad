"""A measured speed ``<axis>.speed``: units, recipes, drafts, resampling, stored versions, clocks and flags."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sysid.datasets import Store, ingest
from sysid.datasets.draft import draft_recipe
from sysid.errors import InputError
from sysid.logs.inspection import ClockSummary, FieldSummary, FileSummary, StreamSummary
from sysid.machine import Machine, machine_from_files

MACHINE = """schema = 1
name = "demo"
rate_hz = 50.0
[[axes]]
name = "boom"
actuation = "velocity"
drives = "joint"
gain = 0.5
limits = [-3.0, 3.0]
[[axes]]
name = "arm"
actuation = "velocity"
drives = "cylinder"
gain = 0.05
stroke = [0.0, 0.5]
"""


def machine() -> Machine:
    return machine_from_files({"machine.toml": MACHINE}, "machine.toml")


def table(rate_hz: float, phase: float = 0.0, seconds: float = 20.0) -> pd.DataFrame:
    """An axis that swings by 0.4 rad at 0.3 Hz: its angle and its rate."""
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    angle = 2.0 * math.pi * 0.3 * time + phase
    return pd.DataFrame({"time": time, "q": 0.4 * np.sin(angle), "w": 0.4 * 2.0 * math.pi * 0.3 * np.cos(angle)})


def logs(folder: Path, unit: str, factor: float, rate_hz: float = 50.0) -> Path:
    """Three canonical recordings whose speed is stored in ``unit``; ``factor`` converts rad/s to it."""
    for number in range(3):
        motion = table(rate_hz, 0.3 * number)
        columns = {
            "time": motion["time"],
            "boom.command": np.clip(motion["w"] / 0.8, -1.0, 1.0),
            "boom.joint": motion["q"],
            f"boom.speed [{unit}]": factor * motion["w"],
        }
        (folder / f"run-{number}").mkdir(parents=True)
        pd.DataFrame(columns).to_csv(folder / f"run-{number}" / "log.csv", index=False)
    (folder / "machine.toml").write_text(MACHINE)
    return folder


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("deg/s", 180.0 / math.pi),
        ("°/s", 180.0 / math.pi),
        ("rpm", 30.0 / math.pi),
        ("rad/s", 1.0),
        ("rev/min", 30.0 / math.pi),
    ],
)
def test_a_canonical_speed_is_stored_in_si_in_every_unit(tmp_path: Path, unit: str, factor: float) -> None:
    dataset = ingest(logs(tmp_path / "logs", unit, factor), tmp_path / "ws")
    assert dataset.units["boom.speed"] == "rad/s"
    recording = dataset.recording("run-1")
    assert recording.signals == ("boom.command", "boom.joint", "boom.speed")
    np.testing.assert_allclose(recording.values("boom.speed"), table(50.0, 0.3)["w"], atol=1e-9)
    loaded = Store(tmp_path / "ws").load("demo@1")
    assert loaded.digest == dataset.digest
    assert loaded.units == dataset.units
    pd.testing.assert_frame_equal(loaded.recording("run-1").table, recording.table)
    assert loaded.quality["recordings"]["run-1"]["signals"]["boom.speed"]["missing"] == 0.0


@pytest.mark.parametrize("unit", ["deg", "Hz", "1/min", "m/s^2"])
def test_a_unit_of_another_quantity_is_refused(tmp_path: Path, unit: str) -> None:
    with pytest.raises(InputError, match=r"rad/s"):
        ingest(logs(tmp_path / "logs", unit, 1.0), tmp_path / "ws")


def test_the_unit_follows_from_what_the_axis_drives(tmp_path: Path) -> None:
    assert machine().expected_unit("arm.speed") == "m/s"
    assert machine().expected_unit("boom.speed") is None  # without a URDF the joint may be revolute or prismatic
    folder = logs(tmp_path / "logs", "rad/s", 1.0)
    for number in range(3):
        path = folder / f"run-{number}" / "log.csv"
        motion = pd.read_csv(path)
        motion["arm.speed [rad/s]"] = 0.1
        motion.to_csv(path, index=False)
    with pytest.raises(InputError, match=r"a unit of \[rad/s\].*expected a unit of \[m/s\]"):
        ingest(folder, tmp_path / "ws")


def test_a_fast_speed_is_low_passed_and_a_slow_one_interpolated(tmp_path: Path) -> None:
    for rate_hz, name in ((1000.0, "fast"), (25.0, "slow")):
        folder = logs(tmp_path / name, "rad/s", 1.0, rate_hz)
        if rate_hz > 50.0:  # a tone above the Nyquist frequency of the grid must not alias into it
            for number in range(3):
                path = folder / f"run-{number}" / "log.csv"
                motion = pd.read_csv(path)
                motion["boom.speed [rad/s]"] += 0.2 * np.sin(2.0 * math.pi * 180.0 * motion["time"])
                motion.to_csv(path, index=False)
        values = ingest(folder, tmp_path / f"ws-{name}").recording("run-0").values("boom.speed")
        expected = table(50.0)["w"].to_numpy()
        inner = slice(25, 950)
        assert np.abs(values[inner] - expected[inner]).max() < 0.005 * np.abs(expected).max()


def two_devices(folder: Path, both: bool) -> Path:
    """A drive measures the speed on its own clock, which begins 0.35 s late; with ``both`` the machine measures it too."""
    entries = ['"boom.command" = { field = "boom.command" }', '"boom.joint" = { field = "boom.joint", unit = "rad" }']
    entries += ['"boom.speed" = { field = "boom.speed", unit = "rad/s", primary = false }'] if both else []
    for number in range(3):
        (folder / f"run-{number}").mkdir(parents=True)
        time = np.arange(2000) / 100.0
        levels = np.random.default_rng(number).normal(size=41)
        speed = 0.3 * np.interp(time, np.arange(41) / 2.0, levels)  # not periodic
        own = {"time": time, "boom.command": np.clip(speed, -1.0, 1.0), "boom.joint": np.cumsum(speed) / 100.0}
        pd.DataFrame({**own, "boom.speed": speed}).to_csv(folder / f"run-{number}" / "machine.csv", index=False)
        pd.DataFrame({"time": time[:-35], "boom.speed": speed[35:]}).to_csv(folder / f"run-{number}" / "drive.csv", index=False)
    (folder / "machine.toml").write_text(MACHINE)
    recipe = ["schema = 1", 'machine = "machine.toml"', "[[streams]]", 'files = "machine.csv"', "[streams.signals]", *entries]
    recipe += ["[[streams]]", 'files = "drive.csv"', 'domain = "drive"', "[streams.signals]"]
    recipe += ['"boom.speed" = { field = "boom.speed", unit = "rad/s" }']
    (folder / "recipe.toml").write_text("\n".join(recipe) + "\n")
    return folder


def test_two_measurements_of_a_speed_align_clocks(tmp_path: Path) -> None:
    clocks = ingest(two_devices(tmp_path / "logs", both=True), tmp_path / "ws").clocks
    assert [record.used_signals for record in clocks] == [("boom.speed",)] * 3
    for record in clocks:
        assert record.applied
        assert record.offset_s == pytest.approx(0.35, abs=0.005)


def test_a_speed_and_a_position_do_not_align_clocks(tmp_path: Path) -> None:
    """A speed is no function of the position, to which the map between two signals would be fitted."""
    clocks = ingest(two_devices(tmp_path / "logs", both=False), tmp_path / "ws").clocks
    assert [record.applied for record in clocks] == [False] * 3
    assert all("no joint or cylinder is measured on both clocks" in record.reason for record in clocks)


def test_a_constant_quantised_speed_and_an_end_stop_are_not_faults(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    for number in range(3):
        (folder / f"run-{number}").mkdir(parents=True)
        time = np.arange(2000) / 50.0
        command = np.repeat([0.0, 0.6, 0.0, -0.6, 0.0], 400)
        speed = np.round(0.5 * command / 0.01) * 0.01  # steps between two samples, constant for eight seconds
        motion = {"time": time, "boom.command": command, "boom.joint": np.cumsum(speed) / 50.0 - 1.0, "boom.speed": speed}
        pd.DataFrame(motion).to_csv(folder / f"run-{number}" / "log.csv", index=False)
    (folder / "machine.toml").write_text(MACHINE)
    flags = ingest(folder, tmp_path / "ws").quality["flags"]
    assert [flag for flag in flags if flag["signal"] == "boom.speed"] == []


def fields(*names: tuple[str, str | None]) -> tuple[FieldSummary, ...]:
    return tuple(FieldSummary(name, unit, -1.0, 1.0, 0.0) for name, unit in names)


def drafted(stream: StreamSummary, reader: str, name: str) -> str:
    return draft_recipe([FileSummary(Path(name), reader, 10, (stream,))], machine())


def test_a_draft_recognises_speeds() -> None:
    clock = ClockSummary("time", 0, 1.0, 10.0, 0.0, 0, 0.0, 0.0, 0)
    known = fields(("boom_cmd", None), ("boom_angle", "deg"), ("boom joint velocity", "deg/s"), ("arm speed", "mm/s"))
    unsure = fields(("arm joint velocity", "rad/s"), ("speed setpoint boom", None))
    text = drafted(StreamSummary("", "", 3, (clock,), (*known, *unsure)), "csv", "log.csv")
    signals = tomllib.loads(text)["streams"][0]["signals"]
    assert {signal: entry["field"] for signal, entry in signals.items()} == {
        "boom.joint": "boom_angle",
        "boom.speed": "boom joint velocity",
        "arm.speed": "arm speed",
    }
    # two fields may be the command
    assert '# "boom.command" = { field = "boom_cmd" }' in text
    assert '# "boom.command" = { field = "speed setpoint boom" }' in text
    # the joint of an axis that drives a cylinder has a rate that is no signal
    assert '# "arm.<command, cylinder, joint or speed>" = { field = "arm joint velocity" }' in text


def test_the_arrays_of_a_joint_state_say_what_they_are() -> None:
    clock = ClockSummary("header", 0, 1.0, 10.0, 0.0, 0, 0.0, 0.0, 0)
    names = fields(("position[boom]", None), ("velocity[boom]", None), ("effort[boom]", None))
    text = drafted(StreamSummary("/joint_states", "sensor_msgs/msg/JointState", 3, (clock,), names), "mcap", "log.mcap")
    signals = tomllib.loads(text)["streams"][0]["signals"]
    assert {signal: entry["field"] for signal, entry in signals.items()} == {
        "boom.joint": "position[boom]",
        "boom.speed": "velocity[boom]",
    }
