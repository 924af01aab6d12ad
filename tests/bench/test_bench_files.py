"""The files: readable by the public libraries of their formats, shaped like real exports; the shipped ones match the recipe."""

from __future__ import annotations

import csv
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from simulated_bench import AXES, BenchRecipe, Run, simulate, write, write_all
from simulated_bench.__main__ import main
from simulated_bench.mcap_log import TOPICS
from simulated_bench.recipe import WIRED

AUTOLOG = Path(__file__).parents[2] / "datasets" / "autolog"
REAL_EXPORTS = Path(__file__).parents[2] / "../shared/data/mocap_files"


@pytest.fixture(scope="module")
def written(short: BenchRecipe, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Run]:
    out = tmp_path_factory.mktemp("logs")
    write_all(short, out)
    return out, simulate(short, "drive")


def test_mcap_is_read_by_the_ros2_decoder(written: tuple[Path, Run]) -> None:
    out, run = written
    seen: dict[str, list[tuple[int, int, int, object]]] = {topic: [] for topic in TOPICS}
    with (out / "drive" / "machine.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        header, summary = reader.get_header(), reader.get_summary()
        assert header.profile == "ros2"
        assert summary is not None
        assert {schema.name for schema in summary.schemas.values()} == {
            "autolog_msgs/msg/ValveCommand",
            "sensor_msgs/msg/JointState",
        }
        assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
        assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
        logged = []
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            stamp = decoded.header.stamp.sec * 1_000_000_000 + decoded.header.stamp.nanosec
            seen[channel.topic].append((stamp, message.publish_time, message.log_time, decoded))
            logged.append(message.log_time)
    assert logged == sorted(logged), "written in the order of arrival"
    for topic, values in (("/valves/command", run.log.command), ("/draw_wires", run.log.wires)):
        field = "command" if topic == "/valves/command" else "position"
        names = AXES if topic == "/valves/command" else WIRED
        rows = sorted(seen[topic], key=lambda row: row[0])
        assert [row[0] for row in rows] == run.log.stamps.tolist()
        assert np.array([getattr(row[3], field) for row in rows]) == pytest.approx(values, abs=0.0)
        assert all(tuple(row[3].name) == names for row in rows)
    slew = sorted(seen["/slew_sensor"], key=lambda row: row[0])
    assert np.array([row[3].position[0] for row in slew]) == pytest.approx(run.log.slew, abs=0.0)
    for rows in seen.values():
        stamps, published, logs = (np.array([row[k] for row in rows]) for k in range(3))
        assert np.all(published > stamps)
        assert np.all(logs > published)
        assert np.std(logs - stamps) > 1e5, "jitter"


def test_mcap_is_read_by_rosbags(written: tuple[Path, Run]) -> None:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    out, run = written
    with AnyReader([out / "drive" / "machine.mcap"], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert counts == dict.fromkeys(TOPICS, len(run.log.stamps))
        commands = [c for c in reader.connections if c.topic == "/valves/command"]
        rows = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(connections=commands)]
    rows.sort(key=lambda row: (row.header.stamp.sec, row.header.stamp.nanosec))
    assert np.array([row.command for row in rows]) == pytest.approx(run.log.command, abs=0.0)


def motive_rows(path: Path) -> list[list[str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def test_motive_export_says_what_the_capture_saw(written: tuple[Path, Run]) -> None:
    out, run = written
    rows = motive_rows(out / "drive" / "mocap.csv")
    header = dict(zip(rows[0][0::2], rows[0][1::2], strict=True))
    assert header["Format Version"] == "1.23"
    assert header["Rotation Type"] == "Quaternion"
    assert header["Length Units"] == "Meters"
    assert int(header["Total Exported Frames"]) == len(run.capture.time) == len(rows) - 7
    body = run.capture.bodies[1]
    columns = [k for k, name in enumerate(rows[3]) if name == body.name]
    assert len(columns) == 8
    assert [rows[6][k] for k in columns] == ["X", "Y", "Z", "W", "X", "Y", "Z", ""]
    data = np.array([[float(row[k]) if row[k] else np.nan for k in columns] for row in rows[7:]])
    expected = np.column_stack([body.quaternion, body.position, body.marker_error])
    assert np.array_equal(np.isnan(data), np.isnan(expected))
    assert np.nanmax(np.abs(data - expected)) <= 0.51e-6
    times = np.array([float(row[1]) for row in rows[7:]])
    assert times == pytest.approx(run.capture.time, abs=0.51e-6)


def test_hidden_bodies_are_empty_cells(written: tuple[Path, Run]) -> None:
    out, run = written
    assert run.capture.dropouts
    text = (out / "drive" / "mocap.csv").read_text("utf-8")
    assert "nan" not in text.lower()
    assert ",,,,,,,," in text


@pytest.mark.parametrize("name", ["motive_1.21_quaternion.csv", "motive_1.22_two_rigid_bodies.csv"])
def test_motive_head_has_the_rows_of_a_real_export(written: tuple[Path, Run], name: str) -> None:
    if not (REAL_EXPORTS / name).is_file():
        pytest.skip("the real exports are not here: ../shared/data/mocap_files")
    real, ours = motive_rows(REAL_EXPORTS / name), motive_rows(written[0] / "drive" / "mocap.csv")
    missing = set(real[0][0::2]) - set(ours[0][0::2]) - {""}
    assert not missing, "every key of the first line"
    assert not any(real[1])
    assert not any(ours[1])
    for k in range(2, 7):
        assert len(ours[k]) == len(ours[2]), "one cell a column in every head row"
    assert ours[2][2] == real[2][2] == "Rigid Body"
    assert ours[4][2].isalnum()
    assert len(ours[4][2]) == len(real[4][2]) == 32
    assert ours[5][2] == real[5][2] == "Rotation"
    assert ours[6][0] == real[6][0] == "Frame"
    assert ours[6][1].startswith("Time")
    if "quaternion" in name:
        assert ours[6][2:9] == real[6][2:9], "x y z w, then x y z"
        ending = (REAL_EXPORTS / name).read_bytes()[:600].count(b"\r\n") > 0
        assert ((written[0] / "drive" / "mocap.csv").read_bytes()[:600].count(b"\r\n") > 0) == ending


def test_exported_markers_are_columns_of_their_own() -> None:
    rows = motive_rows(AUTOLOG / "logs" / "manual-01" / "mocap.csv")
    markers = [k for k, kind in enumerate(rows[2]) if kind == "Marker"]
    assert [rows[3][k] for k in markers[::3]] == [f"gripper_body:Marker{k}" for k in range(1, 5)]
    assert {rows[5][k] for k in markers} == {"Position"}


def test_frames_between_poses_are_left_out(written: tuple[Path, Run]) -> None:
    rows = motive_rows(written[0] / "poses" / "mocap.csv")[7:]
    frames = np.array([int(row[0]) for row in rows])
    times = np.array([float(row[1]) for row in rows])
    assert np.count_nonzero(np.diff(frames) > 1) == 2, "three poses"
    assert times == pytest.approx(frames / 5.0, abs=1e-6)


def test_truth_names_what_is_hidden_and_how_the_clocks_run(written: tuple[Path, Run], short: BenchRecipe) -> None:
    out, run = written
    truth = json.loads((out / "truth.json").read_text("utf-8"))
    hidden = {(e["name"], e["target"]): e["parameters"] for e in truth["effects"] if e["hidden"]}
    assert hidden == {
        ("valve_deadband", "boom"): {"positive": 0.12, "negative": 0.10},
        ("backlash", "slew"): {"width": 0.0105},
        ("gripper_sway", "tool"): {"length": 0.22, "damping_ratio": 0.04},
    }
    clock = truth["recordings"]["drive"]["capture_clock"]
    assert clock["skew_ppm"] == short.capture.skew
    assert clock["offset_s"] == pytest.approx(run.capture.clock.offset - short.capture.latency)
    assert truth["recordings"]["drive"]["start_ns"] == run.log.stamps[0]
    assert len(truth["recordings"]["drive"]["dropouts"]) == len(run.capture.dropouts)


def test_shipped_logs_are_what_the_recipe_gives(recipe: BenchRecipe, manual: Run, tmp_path: Path) -> None:
    """One recording is written again: the same export, the same messages. Compressed bytes may differ between libraries."""
    write(manual, tmp_path)
    shipped = AUTOLOG / "logs" / "manual-01"
    assert (tmp_path / "mocap.csv").read_bytes() == (shipped / "mocap.csv").read_bytes()
    assert messages(tmp_path / "machine.mcap") == messages(shipped / "machine.mcap")


def messages(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            digest.update(f"{channel.topic} {message.log_time} {message.publish_time} ".encode() + message.data)
    return digest.hexdigest()


def test_shipped_logs_stay_small_and_carry_their_checksums() -> None:
    lines = (AUTOLOG / "SHA256SUMS").read_text("utf-8").splitlines()
    sums = {name: digest for digest, name in (line.split(maxsplit=1) for line in lines)}
    files = sorted(path for path in (AUTOLOG / "logs").rglob("*") if path.is_file())
    assert len(files) == 15
    assert sum(path.stat().st_size for path in files) < 15_000_000
    for path in files:
        name = path.relative_to(AUTOLOG).as_posix()
        assert sums[name] == hashlib.sha256(path.read_bytes()).hexdigest(), name


def test_command_line_writes_the_folder_and_refuses_a_bad_recipe(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (AUTOLOG / "bench.toml").read_text("utf-8")
    machine = text[: text.index("[[capture.swaps]]")]
    machine = "\n".join(line for line in machine.splitlines() if not line.startswith("exported_markers"))
    text = machine + '\n[[recordings]]\nname = "only"\nseed = 1\nseconds = 8.0\n'
    recipe = tmp_path / "bench.toml"
    recipe.write_text(text, "utf-8")
    assert main([str(recipe), str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "only" / "machine.mcap").stat().st_size > 10_000
    assert "mocap.csv" in capsys.readouterr().out
    recipe.write_text(text.replace("damping_ratio", "dampin_ratio"), "utf-8")
    assert main([str(recipe), str(tmp_path / "out")]) == 2
    assert "unknown key 'gripper.dampin_ratio'; expected 'damping_ratio'?" in capsys.readouterr().err
