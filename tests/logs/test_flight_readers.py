"""Logs of autopilots: ULog of PX4 as pyulog reads it, DataFlash of ArduPilot as pymavlink reads its messages; damage."""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from attempts import attempt
from command_line import run
from examples import examples
from flight_logs import (
    ULOG_TYPES,
    attitude_dataflash,
    attitude_ulog,
    dataflash,
    dataflash_message,
    dropout,
    ulog,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from small_logs import write_log

from sysid.datasets import Store
from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream, reader_for
from sysid.logs.inspection import inspect_file
from sysid.logs.readers import is_log

pytest.importorskip("pyulog", reason="the extra that reads flight logs is not installed")
pytest.importorskip("pymavlink", reason="the extra that reads flight logs is not installed")

NUMBERS = sorted(set(ULOG_TYPES) - {"char"})


def read(path: Path, *streams: str, **options: Any) -> dict[str, Stream]:
    chosen = ReadOptions(streams=frozenset(streams) or None, **options)
    return {stream.name: stream for stream in reader_for(path).read(path, chosen)}


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("name", "reader", "streams"),
    [
        ("flight.ulg", "ulog", ["vehicle_attitude", "vehicle_attitude#1"]),
        ("flight.bin", "ardupilot", ["ATT", "IMU[0]", "IMU[1]"]),
    ],
)
def test_a_log_is_known_by_its_content_and_shown(tmp_path: Path, name: str, reader: str, streams: list[str]) -> None:
    path = write_log(tmp_path, name)
    other = written(tmp_path / "flight.csv", path.read_bytes())
    assert reader_for(path).name == reader_for(other).name == reader
    seen = inspect_file(path)
    assert [stream.name for stream in seen.streams] == streams
    assert {clock.name for stream in seen.streams for clock in stream.clocks} == {"boot"}
    assert seen.losses == ()
    with pytest.raises(InputError, match=rf"{name}: no \w+ ?\w* '{streams[0]}x'; expected '"):
        read(path, f"{streams[0]}x")
    assert list(read(path, streams[-1])) == streams[-1:]


def test_instances_nested_messages_and_boot_time_of_a_ulog(tmp_path: Path) -> None:
    streams = read(written(tmp_path / "a.ulg", attitude_ulog(12)))
    second = streams["vehicle_attitude#1"]
    assert list(second.columns) == ["ramp", "q[0]", "q[1]", "state.share", "state.count"]
    np.testing.assert_array_equal(second.columns["q[0]"], np.arange(12) ** 2)
    np.testing.assert_array_equal(second.columns["state.share"], np.ones(12))
    np.testing.assert_array_equal(second.stamps["boot"], 5_000_000_000 + 100_000_000 * np.arange(12))
    one = read(tmp_path / "a.ulg", "vehicle_attitude", fields={"vehicle_attitude": frozenset({"ramp"})})["vehicle_attitude"]
    assert (list(one.columns), len(one.fields)) == (["ramp"], 5)


def test_dropouts_cuts_and_damage_of_a_ulog_are_losses(tmp_path: Path) -> None:
    formats, topics = {"a": "uint64_t timestamp;float x;"}, [("a", 0)]
    rows: list[Any] = [(0, struct.pack("<Qf", 1000 * (i + 1), i)) for i in range(10)]
    path = written(tmp_path / "a.ulg", ulog(formats, [*rows[:5], dropout(120), *rows[5:], dropout(30)], topics))
    assert read(path)["a"].losses == ("a.ulg: the logger dropped messages 2 times, for 0.150 s in all and 0.120 s at most",)
    whole = ulog(formats, rows, topics)
    cut = read(written(path, whole[:-3]))["a"]
    assert (len(cut), cut.losses) == (9, ("a.ulg: the file is cut off within its last message",))
    assert read(written(path, whole))["a"].losses == ()
    damaged = ulog(formats, [*rows[:3], struct.pack("<HBHf", 6, ord("D"), 9, 1.0), *rows[3:]], topics)
    assert read(written(path, damaged))["a"].losses == ("a.ulg: damaged bytes or messages have been left out",)
    zero = [(0, struct.pack("<Qf", 0, 9.0)), (0, struct.pack("<Qf", 2**64 - 1, 9.0))]
    timed = read(written(path, ulog(formats, [*rows, *zero], topics)))["a"]
    assert (len(timed), timed.losses) == (10, ("a.ulg: a: 2 messages without a valid time have been left out",))


def test_a_topic_without_a_time_is_left_out(tmp_path: Path) -> None:
    formats = {"a": "uint64_t timestamp;float x;", "b": "uint32_t timestamp;float[2] x;"}
    messages: list[Any] = [(number, struct.pack("<Qf", 1000 + i, i)) for i in range(4) for number in (0, 1)]
    streams = read(written(tmp_path / "a.ulg", ulog(formats, messages, [("a", 0), ("b", 0)])))
    assert list(streams) == ["a"]
    assert streams["a"].losses == ("a.ulg: topics without a timestamp of 64 bits have been left out: b",)


@pytest.mark.parametrize(
    ("formats", "reason"),
    [
        ({"a": "uint64_t timestamp;a next;"}, "message 'a': contains itself"),
        (
            {"a": "uint64_t timestamp;b[300] b;", "b": "c[300] c;", "c": "float[300] x;"},
            r"message 'b': 90000 fields; expected at most",
        ),
        ({"a": "float x;"}, "no messages; expected at least one topic"),
    ],
)
def test_formats_without_an_end_or_a_time_are_refused(tmp_path: Path, formats: dict[str, str], reason: str) -> None:
    path = written(tmp_path / "a.ulg", ulog(formats, [(0, bytes(40))] * 3, [("a", 0)]))
    with pytest.raises(InputError, match=rf"a\.ulg.*({reason})"):
        read(path)


NAMES = st.text("abcxyz_", min_size=1, max_size=6).filter(lambda name: not name.startswith("_"))


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    data=st.data(),
    fields=st.dictionaries(NAMES, st.tuples(st.sampled_from(NUMBERS), st.integers(0, 3)), min_size=1, max_size=5),
)
def test_any_ulog_is_read_as_by_pyulog(tmp_path: Path, data: st.DataObject, fields: dict[str, tuple[str, int]]) -> None:
    from pyulog import ULog

    text = "uint64_t timestamp;" + "".join(
        f"{kind}{f'[{size}]' if size else ''} {name};" for name, (kind, size) in fields.items()
    )
    codes = "<Q" + "".join(ULOG_TYPES[kind] * max(size, 1) for kind, size in fields.values())
    rows = data.draw(st.integers(1, 5))
    bodies = [
        data.draw(st.binary(min_size=struct.calcsize(codes) - 8, max_size=struct.calcsize(codes) - 8)) for _ in range(rows)
    ]
    messages: list[Any] = [(0, struct.pack("<Q", 10 * i + 1) + body) for i, body in enumerate(bodies)]
    path = written(tmp_path / "any.ulg", ulog({"topic": text}, messages, [("topic", 0)]))
    (stream,) = read(path).values()
    (theirs,) = ULog(str(path)).data_list
    assert list(stream.columns) == [name for name in theirs.data if name != "timestamp"]
    for name, values in stream.columns.items():
        np.testing.assert_array_equal(values, theirs.data[name].astype(np.float64))
    np.testing.assert_array_equal(stream.stamps["boot"], theirs.data["timestamp"].astype(np.int64) * 1000)


LETTERS = "abBhHiIfcCeELdMqQgnNZ"


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(letters=st.text(LETTERS, min_size=1, max_size=8), data=st.data())
def test_any_dataflash_log_is_read_as_by_pymavlink(tmp_path: Path, letters: str, data: st.DataObject) -> None:
    from flight_logs import DATAFLASH
    from pymavlink.DFReader import DFReader_binary

    size = struct.calcsize("<" + "".join(DATAFLASH[letter] for letter in letters))
    columns = [f"F{i}" for i in range(len(letters))]
    bodies = data.draw(st.lists(st.binary(min_size=size, max_size=size), min_size=1, max_size=4))
    head = [dataflash_message(1, "Q", (10 * i,)) for i in range(len(bodies))]
    formats = {"ANY": (1, f"Q{letters}", ",".join(["TimeUS", *columns]))}
    path = written(tmp_path / "any.bin", dataflash(formats, [first + body for first, body in zip(head, bodies, strict=True)]))
    numbers = [name for name, letter in zip(columns, letters, strict=True) if letter not in "nNZ"]
    if not numbers:
        with pytest.raises(InputError, match="no numbers in its messages"):
            read(path)
        return
    (stream,) = read(path).values()
    with DFReader_binary(str(path)) as log:
        theirs = [message for _ in range(len(bodies)) if (message := log.recv_match(type="ANY")) is not None]
        assert len(theirs) == len(stream) == len(bodies)
        with np.errstate(invalid="ignore"):
            for name in numbers:
                expected = np.array([np.array(getattr(message, name), dtype=np.float64) for message in theirs])
                found = np.column_stack([stream.columns[key] for key in stream.columns if key.partition("[")[0] == name])
                np.testing.assert_array_equal(found, expected.reshape(len(bodies), -1))
    np.testing.assert_array_equal(stream.stamps["boot"], 10_000 * np.arange(len(bodies)))


def test_units_multipliers_and_instances_of_a_dataflash_log(tmp_path: Path) -> None:
    streams = read(written(tmp_path / "a.bin", attitude_dataflash(12)))
    attitude = streams["ATT"]
    assert attitude.units == {"Ramp": "deg", "Square": "deg", "Yaw": "m"}
    np.testing.assert_array_equal(attitude.columns["Ramp"], np.arange(12) / 10)  # the letter c: hundredths
    second = streams["IMU[1]"]
    np.testing.assert_array_equal(second.columns["AccX"], 0.5 * np.arange(12) + 1.0)
    assert second.units["Raw"] == "cdeg"
    np.testing.assert_array_equal(second.stamps["boot"], 5_000_000_000 + 100_000_000 * np.arange(12))


def test_what_a_dataflash_log_lacks_is_said(tmp_path: Path) -> None:
    formats = {"ATT": (1, "Qf", "TimeUS,Roll"), "OLD": (2, "f", "Roll"), "DSF": (3, "QI", "TimeUS,Dp")}
    messages: list[Any] = [("ATT", (1000 * i, 0.5 * i)) for i in range(4)]
    more = [("OLD", (1.0,)), b"\0" * 7, ("DSF", (9000, 3)), ("DSF", (9500, 5))]
    units = {"ATT": ("s?", "F-")}
    path = written(tmp_path / "a.bin", dataflash(formats, [*messages, *more], units) + dataflash_message(1, "Q", (5000,))[:6])
    attitude = read(path)["ATT"]
    size = path.stat().st_size
    assert attitude.losses == (
        f"a.bin: 13 of {size} bytes belong to no whole message and have been left out",
        "a.bin: messages with no time have been left out: OLD (1)",
        "a.bin: the logger dropped 5 messages (DSF.Dp)",
        "a.bin: ATT: units that are not known have been left out: Roll [strange]",
    )
    assert len(attitude) == 4


@pytest.mark.parametrize(
    ("name", "reason"), [("a.bin", "a39580 as in a DataFlash log.*another kind of .bin file"), ("a.ulg", "as in a ULog")]
)
def test_another_file_with_the_suffix_is_refused(tmp_path: Path, name: str, reason: str) -> None:
    with pytest.raises(InputError, match=rf"{name.replace('.', chr(92) + '.')}: starts with 68656c.*{reason}"):
        read(written(tmp_path / name, b"hello, this is a firmware"))


MACHINE = """
schema = 1
name = "arm"
rate_hz = 10.0
[[axes]]
name = "boom"
actuation = "velocity"
drives = "joint"
gain = 1.0
limits = [-30.0, 30.0]
"""
RECIPE = """
schema = 1
[[streams]]
files = "{name}"
[streams.signals]
"boom.joint" = {{ topic = "{topic}", field = "{field}", unit = "deg" }}
[splits]
fit = ["*"]
"""


@pytest.mark.parametrize(
    ("name", "topic", "field", "scale"),
    [("flight.ulg", "vehicle_attitude#1", "ramp", 10.0), ("flight.bin", "ATT", "Ramp", 0.1)],
)
def test_a_flight_becomes_a_version(tmp_path: Path, name: str, topic: str, field: str, scale: float) -> None:
    recording = tmp_path / "flights" / "first"
    recording.mkdir(parents=True)
    write_log(recording, name)
    (recording / "firmware.bin").write_bytes(b"no log")
    (recording.parent / "machine.toml").write_text(MACHINE)
    (recording.parent / "recipe.toml").write_text(RECIPE.format(name=name, topic=topic, field=field))
    assert run("--workspace", tmp_path / "ws", "ingest", recording.parent) == 0
    table = Store(tmp_path / "ws").load("arm").recording("first").table
    np.testing.assert_allclose(table["boom.joint"], np.radians(scale * np.arange(len(table))), atol=1e-9)
    assert len(table) == 12


def test_other_files_with_the_suffix_are_no_logs_of_a_folder(tmp_path: Path) -> None:
    assert is_log(write_log(tmp_path, "flight.bin"))
    assert not is_log(written(tmp_path / "firmware.bin", b"\x7fELF and so on"))


@pytest.mark.parametrize("name", ["flight.ulg", "flight.bin"])
@pytest.mark.parametrize("module", ["pyulog", "pymavlink"])
def test_without_the_extra_the_error_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, module: str) -> None:
    path = write_log(tmp_path, name)
    for loaded in [key for key in sys.modules if key.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.setitem(sys.modules, module, None)
    if (module == "pyulog") != (name == "flight.ulg"):
        assert read(path)
        return
    extra = {"pyulog": "flight", "pymavlink": "ardupilot"}[module]
    with pytest.raises(InputError, match=rf"{module} is not installed; .*pip install 'sysid-toolkit\[{extra}\]' installs it"):
        read(path)


@settings(max_examples=examples(300), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), name=st.sampled_from(["flight.ulg", "flight.bin"]))
def test_any_damage_ends_in_streams_or_a_reason(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], data: st.DataObject, name: str
) -> None:
    """Nothing is printed on standard output, which has the results."""
    content = bytearray(write_log(tmp_path, name).read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        end = data.draw(st.sampled_from([200, len(content)]))
        content[data.draw(st.integers(3, end - 1))] = data.draw(st.sampled_from([0, 1, 3, 65, 128, 255]))
    path = written(tmp_path / f"damaged{name[-4:]}", bytes(content[: data.draw(st.integers(1, len(content)))]))
    streams, refusal = attempt(InputError, lambda: reader_for(path).read(path, ReadOptions()))
    assert streams is not None or "damaged" in refusal
    for stream in streams or ():
        assert all(len(values) == len(stream) for values in stream.columns.values())
    assert capfd.readouterr().out == ""


def test_a_cut_message_that_the_library_reads_for_ever_is_refused(tmp_path: Path) -> None:
    """Found by fuzzing: it goes back by the whole length of a message of which the file has one byte."""
    data = bytes.fromhex("554c6f67011235012f40") + bytes(38) + bytes.fromhex("420f0000000000280042000000000000") + b"?\0"
    path = written(tmp_path / "cut.ulg", data)
    with pytest.raises(InputError, match="not readable"):
        read(path)


def test_a_type_without_one_valid_time_is_no_stream_and_is_said(tmp_path: Path) -> None:
    path = write_log(tmp_path, "flight.bin")
    data = bytearray(path.read_bytes())
    place = data.rindex(b"\xa3\x95", 0, len(data) - 3)
    data[place + 3 : place + 11] = b"\xff" * 8
    streams = read(written(tmp_path / "late.bin", bytes(data)))
    assert all(len(stream) for stream in streams.values())
    assert any("without a valid time" in loss for stream in streams.values() for loss in stream.losses)


def test_a_ulog_that_sends_the_library_in_a_circle_is_refused_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """58 bytes, found by fuzzing: the library goes back and reads one message for ever, seen after 260 000 reads before."""
    pytest.importorskip("pyulog")
    from sysid.logs import ulog

    path = tmp_path / "flight.ulg"
    path.write_bytes(
        bytes.fromhex(
            "554c6f670112350140422b0fe900000000004228000000000000f6000000ffffff0000ff3a00000000000000000900"
            "00696e743136000100f5ff"
        )
    )
    reads, read = [], ulog._Watched.read

    def counted(file: ulog._Watched, size: int | None = -1) -> bytes:
        reads.append(size)
        return read(file, size)

    monkeypatch.setattr(ulog._Watched, "read", counted)
    with pytest.raises(InputError, match="the same bytes over and over"):
        ulog.UlogReader().read(path, ReadOptions())
    assert len(reads) < 1000
