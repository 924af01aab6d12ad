"""``sysid ingest --inspect``: what it says of real and of made files, and that its draft is accepted once it is filled in."""

from __future__ import annotations

import json
import re
import resource
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from command_line import run
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer

from sysid.datasets.draft import draft_recipe
from sysid.datasets.recipe import load_recipe
from sysid.logs.inspection import ClockSummary, FieldSummary, FileSummary, StreamSummary, inspect_file
from sysid.machine import load_machine


def inspected(capsys: pytest.CaptureFixture[str], *args: str | Path) -> dict[str, Any]:
    assert run("ingest", "--inspect", *args, "--json", "-") == 0
    value: dict[str, Any] = json.loads(capsys.readouterr().out)
    return value


def test_topics_clocks_and_fields_of_a_bag(datasets_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = datasets_folder / "autolog/logs/manual-01"
    seen = inspected(capsys, folder / "machine.mcap", "--machine", datasets_folder / "autolog/machine.toml")
    (file,) = seen["files"]
    streams = {stream["name"]: stream for stream in file["streams"]}
    assert set(streams) == {"/valves/command", "/draw_wires", "/slew_sensor"}
    wires = streams["/draw_wires"]
    assert wires["kind"] == "sensor_msgs/msg/JointState"
    assert wires["samples"] == 6000
    header, log, publish = wires["clocks"]
    assert (header["name"], log["name"], publish["name"]) == ("header", "log", "publish")
    assert header["rate_hz"] == pytest.approx(100.0, rel=1e-3)
    assert header["gaps"] == 0
    middle, low, high = log["behind_s"]
    assert 0.0 < low < middle < high < 0.05
    assert [field["name"] for field in wires["fields"]] == ["position[boom]", "position[stick]", "position[telescope]"]
    recipe = tomllib.loads(seen["recipe"])
    signals = recipe["streams"][0]["signals"]
    assert signals["boom.command"] == {"topic": "/valves/command", "field": "command[boom]"}
    assert {"boom.cylinder", "stick.cylinder", "telescope.joint", "slew.joint", "slew.command"} < set(signals)


def test_a_drafted_recipe_is_ingested_as_it_is_where_all_is_recognised(
    tmp_path: Path, datasets_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("machine.toml", "autolog.urdf"):
        (tmp_path / name).write_bytes((datasets_folder / "autolog" / name).read_bytes())
    log = tmp_path / "manual-01.mcap"
    log.write_bytes((datasets_folder / "autolog/logs/manual-01/machine.mcap").read_bytes())
    draft = tmp_path / "recipe.toml"
    assert run("ingest", "--inspect", log, "--draft", draft) == 0
    assert f"drafted {draft}" in capsys.readouterr().out
    assert run("--workspace", tmp_path / "ws", "ingest", log, "--recipe", draft, "--name", "x", "--json", "-") == 0
    made = json.loads(capsys.readouterr().out)
    signals = {signal for recording in made["recordings"] for signal in recording["signals"]}
    assert {"boom.command", "boom.cylinder", "telescope.joint", "slew.joint"} <= signals
    assert run("ingest", "--inspect", log, "--draft", draft) == 2
    assert "the file exists already; expected a new file" in capsys.readouterr().err
    assert run("ingest", log, "--draft", tmp_path / "other.toml") == 2
    assert "given without --inspect" in capsys.readouterr().err


def test_rigid_bodies_are_offered_with_their_links(datasets_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = datasets_folder / "autolog"
    seen = inspected(capsys, folder / "logs/manual-01/mocap.csv", "--machine", folder / "machine.toml")
    text = seen["recipe"]
    assert 'reader = "motive"' in text
    assert '# boom_body = "boom"   # visible in 99 % of 3517 frames' in text
    assert '# gripper_body = "<link>"' in text
    assert "# joints = { slew = <value>, boom = <value>, stick = <value>, telescope = <value> }" in text
    assert tomllib.loads(text)["streams"][0]["domain"] == "mocap"


def test_markers_are_offered_as_points_and_sets(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = inspected(capsys, shared_data / "mocap_files/markers.trc")["recipe"]
    assert '# ee = { marker = "' in text
    assert '# <body> = ["ASISl", "ASISr", "PSISl"]' in text
    assert '#   "STER": visible in 100 % of 93 frames' in text
    assert "signals" not in tomllib.loads(text)["streams"][0]
    analog = inspected(capsys, shared_data / "mocap_files/Qualisys.c3d")["recipe"]
    assert {"points", "marker_sets", "signals"} <= set(tomllib.loads(analog)["streams"][0])


def test_a_database_names_what_is_in_can_frames(tmp_path: Path, shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = shared_data / "can_logs"
    bare = inspected(capsys, folder / "test_CanMessage.asc")
    assert '# dbc = "<file>.dbc"' in bare["recipe"]
    assert {field["name"] for field in bare["files"][0]["streams"][0]["fields"]} >= {"data[0]", "data[7]"}
    database = tmp_path / "valves.dbc"
    database.write_text('VERSION ""\nBU_: ECU\nBO_ 200 Wires: 8 ECU\n SG_ Boom : 0|8@1+ (0.5,0) [0|127] "mm" ECU\n')
    (stream,) = inspected(capsys, folder / "test_CanMessage.asc", "--dbc", database)["files"][0]["streams"]
    assert (stream["name"], [(field["name"], field["unit"]) for field in stream["fields"]]) == ("Wires", [("Boom", "mm")])
    refused = inspected(capsys, folder / "test_CanMessage.asc", "--dbc", tmp_path / "absent.dbc")
    assert "absent.dbc" in refused["files"][0]["refusal"]


def test_what_an_export_does_not_state_is_asked_for(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = shared_data / "mocap_files/motive_1.22_two_rigid_bodies.csv"
    assert run("ingest", "--inspect", path) == 0
    text = capsys.readouterr().out
    # Read as metres the bodies would be 175 m away.
    assert "the recipe must state length_unit; shown here with 'cm'" in text
    assert 'length_unit = "cm"   # not stated in the file: check it' in text
    assert 'rotation = "XYZ"   # not stated in the file: check it' in text


def test_the_draft_for_a_recording_in_its_folder_is_accepted(
    tmp_path: Path, shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """``logs/<recording>/<file>``: the layout of the guide; topics with and without header stamps in one bag."""
    bag = tmp_path / "logs/run1/nav2_turtlebot.mcap"
    bag.parent.mkdir(parents=True)
    bag.write_bytes((shared_data / "mcap_bags/nav2_turtlebot.mcap").read_bytes())
    axis = '[[axes]]\nname = "drive"\nactuation = "velocity"\ndrives = "joint"\n'
    (tmp_path / "machine.toml").write_text(f'schema = 1\nname = "turtle"\nrate_hz = 20.0\n{axis}')
    draft = tmp_path / "recipe.toml"
    assert run("ingest", "--inspect", tmp_path / "logs", "--draft", draft) == 0
    shown = capsys.readouterr().out
    assert "with constant or no numbers not shown" in shown
    text = draft.read_text("utf-8")
    assert '# fit = ["run1"]' in text
    assert "recordings.files" not in text
    # Header stamps count from the start of a simulation here, those of the log are Unix time: they are never mixed unasked.
    assert 'clock = "log"   # all topics have it; header stamps: an entry of its own for /odom, /amcl_pose\n' in text
    assert "stamp.sec" not in text
    assert run("--workspace", tmp_path / "ws", "ingest", tmp_path) == 2
    assert "recording run1: no signal of the machine; expected commands or sensors. Map fields" in capsys.readouterr().err
    lines = {"/odom": "pose.pose.position.x", "/tf": "transforms[odom].transform.translation.y"}
    for (topic, field), signal in zip(lines.items(), ("drive.joint", "drive.cylinder"), strict=True):
        entry = f'{{ topic = "{topic}", field = "{field}"'
        found = re.search(rf'^# "[^"]*" = {re.escape(entry)}', text, flags=re.MULTILINE)
        assert found is not None
        text = text.replace(found[0], f'"{signal}" = {entry}, unit = "m"')
    draft.write_text(text, "utf-8")
    assert run("--workspace", tmp_path / "ws", "ingest", tmp_path, "--json", "-") == 0
    made = json.loads(capsys.readouterr().out)
    assert {signal for recording in made["recordings"] for signal in recording["signals"]} == {"drive.joint", "drive.cylinder"}


def test_gaps_and_a_time_column_of_another_name_are_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stamps = 1_700_000_000_000 + 10 * np.arange(300)
    stamps[200:] += 1500
    table = pd.DataFrame({"note": "x", "down": -np.arange(300.0), "unix": stamps, "boom [mm]": np.arange(300.0)})
    table.to_csv(tmp_path / "log.csv", index=False)
    seen = inspected(capsys, tmp_path / "log.csv")
    (file,) = seen["files"]
    assert file["stated"] == {"time": "unix", "time_unit": "ms"}
    (clock,) = file["streams"][0]["clocks"]
    assert clock["gaps"] == 1
    assert clock["longest_gap_s"] == pytest.approx(1.51)
    assert clock["longest_gap_at_s"] == pytest.approx(1.99)
    assert clock["rate_hz"] == pytest.approx(100.0)
    assert [field["unit"] for field in file["streams"][0]["fields"]] == [None, "mm"]
    assert run("ingest", "--inspect", tmp_path / "log.csv") == 0
    text = capsys.readouterr().out
    assert "1, longest 1.51 s at 2.0 s" in text
    assert "time from 2023-11-14 22:13:20" in text


def test_a_file_that_cannot_be_read_is_described_by_the_reason(
    tmp_path: Path, shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "broken.mcap").write_bytes(b"nothing")
    assert run("ingest", "--inspect", tmp_path) == 0
    assert "cannot be ingested:" in " ".join(capsys.readouterr().out.split())
    calibration = inspect_file(shared_data / "tiago_mocap/ur10_calibration.csv")
    assert "no time column" in calibration.refusal
    assert len(calibration.streams[0].fields) == 12
    assert run("ingest", "--inspect", tmp_path / "absent") == 2
    assert "no such file or folder" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert run("ingest", "--inspect", tmp_path / "empty") == 2
    assert "no log files" in capsys.readouterr().err


def filled_in(text: str) -> str:
    """The drafted recipe as the excavator's owner fills it in: neutral and span, millimetres, names of the signals."""
    spans = {"Boom Cmd": (7.4745, 2.536), "Stick Cmd": (6.895, 1.966), "Bucket Cmd": (7.614, 2.416)}
    lines = []
    for line in text.splitlines():
        match = re.search(r'field = "(\w+) (Cmd|Ms)"', line)
        if match is not None and match[1] != "Swing":
            axis, what = match[1].lower(), "command" if match[2] == "Cmd" else "cylinder"
            line = re.sub(r'^# "[^"]*"', f'"{axis}.{what}"', line).replace('unit = "<unit>"', 'unit = "mm"')
            neutral, span = spans.get(f"{match[1]} {match[2]}", (0.0, 1.0))
            line = line.replace("<neutral>", str(neutral)).replace("<from neutral to full>", str(span))
        lines.append(line)
    return "\n".join(lines) + "\n"


def test_the_draft_for_the_excavator_is_accepted_once_filled_in(
    tmp_path: Path, shared_data: Path, datasets_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The walk of docs/guide/own-logs.md, and its result beside the recipe that ships."""
    (tmp_path / "machine.toml").write_bytes((datasets_folder / "rc_excavator/machine.toml").read_bytes())
    logs = shared_data / "rc_excavator"
    draft = tmp_path / "recipe.toml"
    assert run("ingest", "--inspect", logs, "--machine", tmp_path / "machine.toml", "--draft", draft) == 0
    capsys.readouterr()
    text = draft.read_text("utf-8")
    assert text.count(' = "steps_') == 9
    assert "zero = <neutral>, span = <from neutral to full>" in text
    draft.write_text(filled_in(text), "utf-8")
    assert set(load_recipe(draft).streams[0].signals) == {
        f"{axis}.{what}" for axis in ("boom", "stick", "bucket") for what in ("command", "cylinder")
    }
    assert run("--workspace", tmp_path / "ws", "ingest", logs, "--recipe", draft, "--name", "rc", "--json", "-") == 0
    made = json.loads(capsys.readouterr().out)
    assert len(made["recordings"]) == 14, "without [splits] the joystick log is cut: a step test moves one axis only"
    assert made["lacks"] == []


def test_no_name_breaks_the_draft() -> None:
    clock = ClockSummary("log", 0, 1.0, 10.0, 0.0, 0, 0.0, 0.0, 0)

    @given(st.text(max_size=8), st.text(max_size=8))
    def check(topic: str, name: str) -> None:
        fields = (FieldSummary(name, None, 0.0, 1.0, 0.0),)
        streams = (StreamSummary(topic, "", 3, (clock,), fields), StreamSummary(name, "p/M", 3, (clock,), fields))
        text = draft_recipe([FileSummary(Path(f"{'x'}.mcap"), "mcap", 10, streams)])
        assert tomllib.loads(text)["streams"][0]["files"] == "x.mcap"

    check()


def test_logs_that_need_a_named_reader_are_found_with_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run.json").write_text(json.dumps([{"time": 0.1 * k, "boom": k} for k in range(20)]))
    assert run("ingest", "--inspect", tmp_path) == 2
    assert "run.json is no log unless its reader is named" in capsys.readouterr().err
    seen = inspected(capsys, tmp_path, "--reader", "json")
    assert seen["files"][0]["streams"][0]["samples"] == 20
    assert tomllib.loads(seen["recipe"])["streams"][0]["reader"] == "json"


AXES = {
    "valve": ("velocity", "cylinder", "stroke = [0.0, 1.0]"),
    "arm": ("velocity", "joint", "limits = [-3.0, 3.0]"),
    "servo": ("position", "joint", "limits = [-3.0, 3.0]"),
    "motor": ("force", "joint", "inertia = 1.0\nlimits = [-3.0, 3.0]"),
}
MACHINE = 'schema = 1\nname = "rig"\nrate_hz = 50.0\n' + "".join(
    f'[[axes]]\nname = "{name}"\nactuation = "{actuation}"\ndrives = "{drives}"\n{rest}\n'
    for name, (actuation, drives, rest) in AXES.items()
)


def offered(folder: Path, columns: list[str]) -> dict[str, tuple[str, bool]]:
    """Column → the signal for which the draft offers it, and whether its line is used as it is."""
    (folder / "machine.toml").write_text(MACHINE)
    table = {"time": np.arange(100) / 50.0, **{name: np.sin(np.arange(100) / 9.0 + k) for k, name in enumerate(columns)}}
    pd.DataFrame(table).to_csv(folder / "log.csv", index=False)
    description = load_machine(folder / "machine.toml")
    text = draft_recipe([inspect_file(folder / "log.csv")], description)
    lines = re.findall(r'^(# )?"([^"]*)" = \{ field = "([^"]*)"', text, flags=re.MULTILINE)
    return {field: (signal, not commented) for commented, signal, field in lines}


@pytest.mark.parametrize(
    ("column", "signal", "sure"),
    [
        ("servo_goal_position [rad]", "servo.command", True),
        ("goal_pos_servo [deg]", "servo.command", True),
        ("goal_pos_servo", "servo.command", False),  # its unit is not known
        ("present_position_servo [rad]", "servo.joint", True),
        ("servo present pos (deg)", "servo.joint", True),
        ("valve desired", "valve.command", True),
        ("valve measured [mm]", "valve.cylinder", True),
        ("valve actual [rad]", "valve.cylinder", False),  # not a length
        ("motor target torque [N·m]", "motor.command", True),
        ("motor torque [N·m]", "motor.<command, cylinder, joint or speed>", False),
        ("arm velocity command", "arm.command", True),
        ("servo velocity command [rad/s]", "servo.<command, cylinder, joint or speed>", False),
        ("arm command feedback", "arm.<command, cylinder, joint or speed>", False),
        ("arm joystick", "arm.<command, cylinder, joint or speed>", False),
        ("arm pose position x [m]", "arm.<command, cylinder, joint or speed>", False),
    ],
)
def test_names_of_goals_and_of_what_is_there(tmp_path: Path, column: str, signal: str, sure: bool) -> None:
    assert list(offered(tmp_path, [column]).values()) == [(signal, sure)]


def test_two_candidates_are_a_question(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = offered(tmp_path, ["arm cmd", "arm setpoint", "valve cmd", "arm angle [rad]"])
    assert found == {
        "arm cmd": ("arm.command", False), "arm setpoint": ("arm.command", False), "valve cmd": ("valve.command", True),
        "arm angle": ("arm.joint", True),
    }  # fmt: skip
    text = inspected(capsys, tmp_path / "log.csv")["recipe"]
    assert text.count("one of several for arm.command: choose") == 2


def test_muscles_and_temperatures_are_no_signals(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert set(offered(tmp_path, ["arm biceps [mV]", "arm oil [degC]", "valve command [V]", "arm cmd"])) == {
        "valve command",
        "arm cmd",
    }
    text = inspected(capsys, tmp_path / "log.csv")["recipe"]
    assert "# no unit of a signal: arm biceps [mV], arm oil [degC]" in text


def test_the_pose_of_the_capture_frame_is_not_known(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = inspected(capsys, shared_data / "mocap_files/markers.trc")["recipe"]
    assert "# translation = [<x>, <y>, <z>]" in text
    assert "frame" not in tomllib.loads(text)["streams"][0]


def test_a_header_with_a_unit_is_drafted_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(MACHINE)
    table = pd.DataFrame({"arm.command": np.sin(np.arange(900) / 9.0), "arm.joint [rad]": np.cos(np.arange(900) / 9.0)})
    table.to_csv(tmp_path / "log.csv", index=False)  # without a time
    draft = tmp_path / "recipe.toml"
    assert run("ingest", "--inspect", tmp_path / "log.csv", "--draft", draft) == 0
    draft.write_text(draft.read_text("utf-8").replace("# rate_hz = <rate>", "rate_hz = 50.0"), "utf-8")
    assert set(load_recipe(draft).streams[0].signals) == {"arm.command", "arm.joint"}
    assert run("--workspace", tmp_path / "ws", "ingest", tmp_path / "log.csv", "--recipe", draft) == 0
    as_in_the_file = draft.read_text("utf-8").replace('field = "arm.joint"', 'field = "arm.joint [rad]", unit = "rad"')
    draft.write_text(as_in_the_file, "utf-8")
    assert run("--workspace", tmp_path / "ws", "ingest", tmp_path / "log.csv", "--recipe", draft) == 0


def test_files_of_one_layout_are_shown_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number in range(73):
        table = pd.DataFrame({"time": np.arange(50 + number) / 50.0, "arm cmd": np.sin(np.arange(50 + number) / 9.0) * number})
        table.to_csv(tmp_path / f"run{number}.csv", index=False)
    pd.DataFrame({"time": np.arange(50) / 50.0, "boom": np.arange(50.0)}).to_csv(tmp_path / "other.csv", index=False)
    seen = tmp_path / "seen.json"
    assert run("ingest", "--inspect", tmp_path, "--draft", tmp_path / "r.toml", "--json", seen) == 0
    shown = capsys.readouterr().out
    assert len(shown.splitlines()) < 60
    assert "73 files of one layout" in shown
    assert f"{sum(range(50, 123))}" in shown
    assert len(json.loads(seen.read_text("utf-8"))["files"]) == 74


def test_a_stroke_that_is_missing_is_proposed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = tmp_path / "machine.toml"
    machine.write_text(MACHINE.replace("stroke = [0.0, 1.0]\n", ""))
    rows = np.arange(900)
    pd.DataFrame(
        {"time": rows / 50.0, "valve cmd": np.sin(rows / 90.0), "valve cyl [mm]": 250.0 + 200.0 * np.cos(rows / 90.0)}
    ).to_csv(tmp_path / "log.csv", index=False)
    assert run("--workspace", tmp_path / "ws", "ingest", tmp_path / "log.csv") == 2
    assert "axis 'valve': no stroke" in capsys.readouterr().err
    draft = tmp_path / "recipe.toml"
    assert run("ingest", "--inspect", tmp_path / "log.csv", "--draft", draft) == 0
    shown = " ".join(capsys.readouterr().out.split())
    proposed = re.search(r"axis 'valve' needs stroke = .*at least (stroke = \[[^\]]*\])", shown)
    assert proposed is not None
    machine.write_text(MACHINE.replace("stroke = [0.0, 1.0]", proposed[1]))
    assert run("--workspace", tmp_path / "ws", "ingest", tmp_path / "log.csv", "--recipe", draft) == 0


@pytest.mark.parametrize("kind", [pytest.param("csv", marks=pytest.mark.slow), "mcap"])
def test_looking_costs_no_more_than_ingesting(tmp_path: Path, kind: str) -> None:
    """Each file is read in a process of its own, which must not load libraries again for every file."""
    for number in range(10):
        folder = tmp_path / f"logs/run{number}"
        folder.mkdir(parents=True)
        rows = [{"time": k / 50.0, "arm.command": np.sin(k / 9.0 + number), "arm.joint": np.cos(k / 9.0)} for k in range(300)]
        if kind == "csv":
            pd.DataFrame(rows).rename(columns={"arm.joint": "arm.joint [rad]"}).to_csv(folder / "log.csv", index=False)
            continue
        with (folder / "log.mcap").open("wb") as file:
            writer = Writer(file)
            writer.start()
            channel = writer.register_channel("/arm", "json", 0)
            for row in rows:
                stamp = int(1e9 * (1.7e9 + row.pop("time")))
                writer.add_message(channel, stamp, json.dumps(row).encode(), stamp)
            writer.finish()
    (tmp_path / "machine.toml").write_text(MACHINE)

    def seconds(*arguments: str) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-m", "sysid.cli", *arguments], check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    logs, machine = str(tmp_path / "logs"), str(tmp_path / "machine.toml")
    looking = seconds("ingest", "--inspect", logs, "--machine", machine)
    assert looking <= seconds("--workspace", str(tmp_path / "ws"), "ingest", logs, "--machine", machine)
