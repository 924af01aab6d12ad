"""CAN logs: signals as cantools decodes them, every file format, databases and damage."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from cantools.database.can import Database, Message, Signal
from cantools.database.conversion import BaseConversion
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream, reader_for
from sysid.logs.can_frames import FrameLog, Frames, read_frames
from sysid.logs.can_signals import decode, is_j1939, load_database, measured
from sysid.logs.limits import Budget

BUDGET = Budget.of(100_000)

DBC = """VERSION ""
BS_:
BU_: ECU
BO_ 423 SLEW: 8 ECU
 SG_ position : 7|24@0- (0.000001,0) [0|0] "rad" ECU
 SG_ counter : 24|8@1+ (1,0) [0|0] "" ECU
BO_ 2566869031 WIRES: 8 ECU
 SG_ boom : 0|21@1- (0.01,0) [0|0] "mm" ECU
 SG_ stick : 21|21@1- (0.01,0) [0|0] "mm" ECU
BO_ 512 MODES: 8 ECU
 SG_ mode M : 0|8@1+ (1,0) [0|0] "" ECU
 SG_ slow m1 : 8|16@1- (0.5,10) [0|0] "" ECU
 SG_ fast m2 : 8|32@1- (1,0) [0|0] "" ECU
SIG_VALTYPE_ 512 fast : 1;
"""


@pytest.fixture
def dbc(tmp_path: Path) -> Path:
    path = tmp_path / "machine.dbc"
    path.write_text(DBC)
    return path


def read(path: Path, dbc: Path | None = None, *streams: str) -> dict[str, Stream]:
    options = ReadOptions(dbc=dbc, streams=frozenset(streams) or None)
    return {stream.name: stream for stream in reader_for(path).read(path, options)}


def message(at: float, identifier: int, data: bytes, extended: bool = False, **more: object) -> can.Message:
    return can.Message(timestamp=at, arbitration_id=identifier, data=data, is_extended_id=extended, channel=0, **more)  # type: ignore[arg-type]


def frames_of(payloads: list[bytes]) -> Frames:
    width = max(map(len, payloads))
    data = np.array([list(payload.ljust(width, b"\0")) for payload in payloads], np.uint8).reshape(-1, width)
    return Frames(np.arange(len(payloads)), data, np.array([len(payload) for payload in payloads]))


@st.composite
def messages(draw: st.DrawFn) -> Message:
    """One signal anywhere in a message of 1 to 12 bytes."""
    size = draw(st.integers(1, 12))
    is_float = draw(st.booleans()) and size >= 2
    if is_float:
        length = draw(st.sampled_from([bits for bits in (16, 32, 64) if bits <= 8 * size]))
    else:
        length = draw(st.integers(1, min(8 * size, 64)))
    first = draw(st.integers(0, 8 * size - length))
    big = draw(st.booleans())
    # In the numbering of big endian signals the first bit of a byte is its most significant one.
    start = 8 * (first // 8) + 7 - first % 8 if big else first
    scale = draw(st.sampled_from([1, 2, 0.5, 0.01, -3.7]))
    conversion = BaseConversion.factory(scale, draw(st.sampled_from([0, 7, -40.25])), is_float=is_float)
    order = "big_endian" if big else "little_endian"
    signal = Signal("s", start, length, order, is_signed=draw(st.booleans()) and not is_float, conversion=conversion)
    return Message(1, "M", size, [signal])


@settings(max_examples=examples(300), deadline=None)
@given(messages(), st.data())
def test_any_signal_is_decoded_as_by_cantools(described: Message, data: st.DataObject) -> None:
    payloads = data.draw(st.lists(st.binary(min_size=described.length, max_size=described.length), min_size=1, max_size=4))
    expected = [float(described.decode(payload)["s"]) for payload in payloads]  # type: ignore[index, arg-type, call-overload]
    with np.errstate(invalid="ignore", over="ignore"):
        found = decode(described, frames_of(payloads))["s"]
    np.testing.assert_allclose(found, expected, rtol=1e-15, atol=0.0)


def test_all_messages_of_a_real_database_are_decoded_as_by_cantools(shared_data: Path) -> None:
    database = load_database(shared_data / "can_logs" / "vehicle.dbc")
    rng = np.random.default_rng(3)
    assert len(database.messages) > 200
    for described in database.messages:
        payloads = [rng.bytes(described.length) for _ in range(5)]
        columns = decode(described, frames_of(payloads))
        for row, payload in enumerate(payloads):
            expected = described.decode(payload, decode_choices=False)
            assert isinstance(expected, dict)
            assert set(expected) == set(columns)
            for name, value in expected.items():
                assert columns[name][row] == pytest.approx(float(value), rel=1e-14), (described.name, name)  # type: ignore[arg-type]


def test_a_signal_of_more_than_64_bits_goes_through_cantools() -> None:
    wide, near = Signal("wide", 0, 80, "little_endian"), Signal("near", 80, 16, "little_endian", is_signed=True)
    described = Message(1, "M", 12, [wide, near])
    columns = decode(described, frames_of([bytes(range(12)), b"\xff" * 12, b"\1" * 5]))
    assert columns["wide"][0] == float(int.from_bytes(bytes(range(10)), "little"))
    np.testing.assert_array_equal(columns["near"], [0x0B0A, -1.0, np.nan])


def test_multiplexed_signals_are_missing_where_another_is_selected(dbc: Path) -> None:
    described = load_database(dbc).get_message_by_name("MODES")
    payloads = [b"\1" + struct.pack("<h", -4) + bytes(5), b"\2" + struct.pack("<f", 1.5) + bytes(3), b"\7" + bytes(7)]
    columns = decode(described, frames_of(payloads))
    np.testing.assert_array_equal(columns["mode"], [1, 2, 7])
    np.testing.assert_array_equal(columns["slow"], [8.0, np.nan, np.nan])
    np.testing.assert_array_equal(columns["fast"], [np.nan, 1.5, np.nan])


def test_each_selection_of_a_multiplexer_is_a_stream_with_its_own_stamps(tmp_path: Path, dbc: Path) -> None:
    path = tmp_path / "bus.blf"
    with can.BLFWriter(path) as log:
        for i in range(12):
            slow = b"\1" + struct.pack("<h", i) + bytes(5)
            payload = b"\2" + struct.pack("<f", 0.5 * i) + bytes(3) if i % 4 else slow
            log.on_message_received(message(1.7e9 + 0.01 * i, 512, payload))
    streams = read(path, dbc)
    assert {name: len(stream) for name, stream in streams.items()} == {"MODES": 12, "MODES[mode=1]": 3, "MODES[mode=2]": 9}
    np.testing.assert_array_equal(streams["MODES[mode=1]"].columns["slow"], 0.5 * np.array([0, 4, 8]) + 10.0)
    np.testing.assert_allclose(np.diff(streams["MODES[mode=1]"].stamps["log"]), 40_000_000, atol=1000)
    assert list(streams["MODES"].columns) == ["mode"]
    with pytest.raises(InputError, match=r"no message 'MODES\[mode=3\]'; expected 'MODES\[mode="):
        read(path, dbc, "MODES[mode=3]")
    misplaced = ReadOptions(dbc=dbc, streams=frozenset({"MODES"}), fields={"MODES": frozenset({"slow"})})
    with pytest.raises(InputError, match=r'selects it; expected the stream .*Write `topic = "MODES\[mode=1\]"` in the recipe'):
        reader_for(path).read(path, misplaced)


def test_selections_within_selections_and_of_several_numbers(tmp_path: Path) -> None:
    """Extended multiplexing: a multiplexer that another one selects, and a signal of several numbers."""
    dbc, path = tmp_path / "m.dbc", tmp_path / "bus.blf"
    dbc.write_text(
        'VERSION ""\nBS_:\nBU_: ECU\nBO_ 512 MODES: 8 ECU\n SG_ mode M : 0|8@1+ (1,0) [0|0] "" ECU\n'
        ' SG_ page m1M : 8|8@1+ (1,0) [0|0] "" ECU\n SG_ deep m2 : 16|16@1- (1,0) [0|0] "" ECU\n'
        ' SG_ wide m3 : 16|16@1- (1,0) [0|0] "" ECU\nSG_MUL_VAL_ 512 page mode 1-1;\nSG_MUL_VAL_ 512 deep page 2-2;\n'
        "SG_MUL_VAL_ 512 wide mode 3-5, 7-7;\n"
    )
    with can.BLFWriter(path) as log:
        for i, (mode, page) in enumerate([(1, 2), (1, 3), (3, 0), (7, 2), (6, 0), (1, 2)]):
            log.on_message_received(message(1.7e9 + 0.01 * i, 512, struct.pack("<BBh4x", mode, page, i)))
    streams = read(path, dbc)
    expected = {"MODES": 6, "MODES[mode=1]": 3, "MODES[mode=1][page=2]": 2, "MODES[mode=3-5,7]": 2}
    assert {name: len(stream) for name, stream in streams.items()} == expected
    np.testing.assert_array_equal(streams["MODES[mode=1][page=2]"].columns["deep"], [0, 5])
    np.testing.assert_array_equal(streams["MODES[mode=3-5,7]"].columns["wide"], [2, 3])


def write_log(path: Path, start: float) -> None:
    wires = cantools.database.load_string(DBC).get_message_by_name("WIRES")
    with can.Logger(path) as log:  # type: ignore[attr-defined]
        for i in range(20):
            log.on_message_received(message(start + 0.01 * i, 423, struct.pack(">i", 1000 * i)[1:] + bytes([i, 0, 0, 0, 0])))
            payload = wires.encode({"boom": 0.5 * i, "stick": -0.25 * i})
            log.on_message_received(message(start + 0.01 * i + 0.001, wires.frame_id, payload, extended=True))
        log.on_message_received(message(start + 0.2, 0x99, b"\1\2"))


@pytest.mark.parametrize(("suffix", "start"), [(".blf", 1.7e9), (".asc", 0.0), (".trc", 1.7e9), (".log", 1.7e9)])
def test_the_same_frames_from_every_format(tmp_path: Path, dbc: Path, suffix: str, start: float) -> None:
    path = tmp_path / f"bus{suffix}"
    write_log(path, start)
    from sysid.logs.can import CanReader

    streams = {s.name: s for s in CanReader().read(path, ReadOptions(dbc=dbc))}
    assert set(streams) == {"SLEW", "WIRES"}
    slew, wires = streams["SLEW"], streams["WIRES"]
    np.testing.assert_allclose(slew.columns["position"], 1e-3 * np.arange(20), atol=1e-12)
    np.testing.assert_array_equal(slew.columns["counter"], np.arange(20))
    np.testing.assert_allclose(wires.columns["stick"], -0.25 * np.arange(20), atol=1e-12)
    assert (slew.units, wires.units["boom"]) == ({"position": "rad"}, "mm")
    np.testing.assert_allclose(np.diff(slew.stamps["log"]), 10_000_000, atol=1000)
    np.testing.assert_allclose(wires.stamps["log"] - slew.stamps["log"], 1_000_000, atol=1000)
    assert slew.losses == (f"bus{suffix}: 1 frames of 1 identifiers that machine.dbc does not have: 0x99 (1)",)


def test_stamps_of_a_blf_file_keep_their_nanoseconds(tmp_path: Path) -> None:
    path = tmp_path / "bus.blf"
    with can.BLFWriter(path) as log:
        log.on_message_received(message(1.7e9, 1, bytes(8)))
        log.start_timestamp = 0.0  # from here on the writer takes stamps as they count from the start
        log.on_message_received(message(0.123456789, 1, bytes(8)))
        log.start_timestamp = 1.7e9
    frames = read_frames(path, BUDGET).frames["0", 1, False]
    np.testing.assert_array_equal(frames.stamps, [1_700_000_000_000_000_000, 1_700_000_000_123_456_789])


def test_one_message_can_be_asked_for_and_an_unknown_one_is_named(tmp_path: Path, dbc: Path) -> None:
    path = tmp_path / "bus.blf"
    write_log(path, 1.7e9)
    assert set(read(path, dbc, "WIRES")) == {"WIRES"}
    with pytest.raises(InputError, match=r"no message 'WIRE'; expected 'WIRES'\?"):
        read(path, dbc, "WIRE")


def test_without_a_database_every_identifier_is_a_stream_of_bytes(tmp_path: Path) -> None:
    path = tmp_path / "bus.blf"
    write_log(path, 1.7e9)
    streams = read(path)
    assert set(streams) == {"0x1A7", "0x18FF5027x", "0x99"}
    np.testing.assert_array_equal(streams["0x99"].columns["data[1]"], [2.0])
    np.testing.assert_array_equal(streams["0x1A7"].columns["data[3]"], np.arange(20))


def test_short_frames_are_missing_and_counted(tmp_path: Path, dbc: Path) -> None:
    path = tmp_path / "bus.asc"
    with can.ASCWriter(path) as log:
        log.on_message_received(message(1.0, 423, b"\0\0\1" + bytes(5)))
        log.on_message_received(message(1.1, 423, b"\0\0"))
    slew = read(path, dbc)["SLEW"]
    np.testing.assert_array_equal(slew.columns["position"], [1e-6, np.nan])
    assert slew.losses == ("bus.asc: SLEW: 1 frames are shorter than 8 bytes",)


def test_j1939_messages_are_known_whoever_sends_them(tmp_path: Path, shared_data: Path) -> None:
    path = tmp_path / "bus.asc"
    with can.ASCWriter(path) as log:
        for sender in (0x00, 0x17):
            log.on_message_received(message(1.0 + sender, 0x0CF00400 | sender, bytes([0, 0, 0, 0x40, 0x1F, 0, 0, 0]), True))
    streams = read(path, shared_data / "can_logs" / "almost-J1939.dbc")
    assert set(streams) == {"EEC1@0xCF00400x", "EEC1@0xCF00417x"}
    for stream in streams.values():
        np.testing.assert_array_equal(stream.columns["EngineSpeed"], [1000.0])


def described(signals: str, extended: bool = True, protocol: str = "") -> Database:
    """A database with one message of 8 bytes; ``protocol``: its attributes."""
    text = f'VERSION ""\nBS_:\nBU_: ECU\nBO_ {(0x80000000 if extended else 0) | 0x100} M: 8 ECU\n{signals}\n{protocol}'
    database = cantools.database.load_string(text, database_format="dbc", strict=False)
    assert isinstance(database, Database)
    return database


J1939 = 'BA_DEF_ "ProtocolType" STRING ;\nBA_DEF_DEF_ "ProtocolType" "";\nBA_ "ProtocolType" "J1939";\n'
FRAME_FORMAT = (
    'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    'BA_DEF_DEF_ "VFrameFormat" "ExtendedCAN";\n'
)


@pytest.mark.parametrize(
    ("extended", "protocol", "expected"),
    [
        (True, J1939, True),
        (False, J1939, False),
        (True, "", False),
        (True, FRAME_FORMAT + 'BA_ "VFrameFormat" BO_ 2147483904 3;\n', True),
        (True, FRAME_FORMAT + J1939 + 'BA_ "VFrameFormat" BO_ 2147483904 1;\n', False),
        (True, FRAME_FORMAT + J1939, True),
    ],
)
def test_j1939_is_what_the_database_or_the_message_says(extended: bool, protocol: str, expected: bool) -> None:
    database = described(' SG_ s : 0|16@1+ (1,0) [0|0] "" ECU', extended, protocol)
    assert is_j1939(database.messages[0], database) == expected


@settings(max_examples=examples(300), deadline=None)
@given(data=st.data(), length=st.integers(1, 40), scale=st.sampled_from([1.0, 0.01, -2.0]), signed=st.booleans())
def test_the_ranges_of_j1939_decide_what_is_a_value(data: st.DataObject, length: int, scale: float, signed: bool) -> None:
    """SAE J1939-71: of whole bytes up to 0xFA…, of two bits 0 and 1, of other lengths all but all ones."""
    raw = data.draw(
        st.integers(0, 2**length - 1)
        | st.integers(0, min(6 * 2 ** max(length - 8, 0), 2**length) - 1).map(lambda n: 2**length - 1 - n)
    )
    database = described(f' SG_ s : 0|{length}@1{"-" if signed else "+"} ({scale},-7) [0|0] "" ECU', protocol=J1939)
    frames = frames_of([raw.to_bytes(8, "little")])
    columns = decode(database.messages[0], frames)
    result, said = measured(database.messages[0], True, frames, columns)
    if signed or length == 1:
        last = 2**length - 1
    elif length == 2:
        last = 1
    elif length in (8, 16, 24, 32):
        last = 0xFB * 2 ** (length - 8) - 1
    else:
        last = 2**length - 2
    assert np.isnan(result["s"][0]) == (raw > last)
    assert bool(said) == (raw > last)
    if raw <= last:
        assert result["s"][0] == columns["s"][0]


def test_what_j1939_has_no_value_for_is_missing_and_counted(tmp_path: Path) -> None:
    dbc, path = tmp_path / "m.dbc", tmp_path / "l.blf"
    signals = ' SG_ boom : 0|16@1+ (0.0001,-3.2) [-3.2|3.2] "rad" ECU\n SG_ on : 16|2@1+ (1,0) [0|3] "" ECU\n'
    dbc.write_text(f'VERSION ""\nBS_:\nBU_: ECU\nBO_ 2566844672 POS: 8 ECU\n{signals}{J1939}')
    raws = [0, 0xFAFF, 0xFB00, 0xFDFF, 0xFE00, 0xFEFF, 0xFEAA, 0xFF00, 0xFFFF]
    with can.BLFWriter(path) as log:
        for i, raw in enumerate(raws):
            payload = struct.pack("<HB5x", raw, i % 4)
            log.on_message_received(message(1.7e9 + 0.01 * i, 0x18FEF1AA, payload, extended=True))
    stream = read(path, dbc)["POS"]
    np.testing.assert_allclose(stream.columns["boom"], [-3.2, 3.2255, *[np.nan] * 7])
    np.testing.assert_array_equal(stream.columns["on"], [0, 1, np.nan, np.nan] * 2 + [0])
    assert stream.losses == (
        "l.blf: POS: boom: 2 samples 'not available', 3 'error', 2 'indicator or reserved' (SAE J1939-71): missing",
        "l.blf: POS: boom: 1 value outside of the range -3.2 to 3.2 that the database states: kept",
        "l.blf: POS: on: 2 samples 'not available', 2 'error' (SAE J1939-71): missing",
    )
    one = ReadOptions(dbc=dbc, streams=frozenset({"POS"}), fields={"POS": frozenset({"on"})})
    (stream,) = reader_for(path).read(path, one)
    assert len(stream.losses) == 1


@settings(max_examples=examples(200), deadline=None)
@given(length=st.integers(2, 32), share=st.floats(0.0, 1.0), raw=st.integers(0, 2**32 - 1), data=st.data())
def test_outside_of_a_stated_range_all_ones_are_missing_and_others_kept(
    length: int, share: float, raw: int, data: st.DataObject
) -> None:
    ones = 2**length - 1
    raw = data.draw(st.sampled_from([ones, raw % 2**length]))
    highest = int(share * ones)
    database = described(f' SG_ s : 0|{length}@1+ (1,0) [0|{highest}] "" ECU', extended=False)
    frames = frames_of([raw.to_bytes(8, "little")])
    result, said = measured(database.messages[0], False, frames, decode(database.messages[0], frames))
    outside = raw > highest > 0
    assert np.isnan(result["s"][0]) == (outside and raw == ones)
    assert bool(said) == outside
    if not np.isnan(result["s"][0]):
        assert result["s"][0] == raw


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "the file is empty"),
        ("hello\n", r"not readable as a CAN database \(.*line 1.*\); expected a DBC file"),
        ('VERSION ""\nBS_:\nBU_:\n', r"no messages; expected at least one message \(BO_\)"),
    ],
)
def test_a_bad_database_is_refused_by_name(tmp_path: Path, text: str, reason: str) -> None:
    log, dbc = tmp_path / "bus.blf", tmp_path / "bad.dbc"
    write_log(log, 1.7e9)
    dbc.write_text(text)
    with pytest.raises(InputError, match=rf"bad\.dbc: {reason}"):
        read(log, dbc)


def test_the_database_of_another_bus_is_refused(tmp_path: Path, dbc: Path) -> None:
    path = tmp_path / "bus.asc"
    with can.ASCWriter(path) as log:
        log.on_message_received(message(1.0, 0x123, b"\1"))
    with pytest.raises(InputError, match=r"describes no frame of bus\.asc; expected identifiers of the log: 0x123\. Choose"):
        read(path, dbc)


def test_stamps_relative_to_the_event_before_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bus.asc"
    path.write_text("date Sat Sep 30 15:06:13.191 2017\nbase hex  timestamps relative\n 0.1 1  123 Rx d 1 68\n")
    with pytest.raises(InputError, match="stamps relative to the event before; expected absolute stamps"):
        read(path)


def test_a_cut_off_file_gives_what_is_left_of_it(tmp_path: Path) -> None:
    path = tmp_path / "bus.blf"
    with can.BLFWriter(path, compression_level=0) as log:
        for i in range(9000):
            log.on_message_received(message(1.7e9 + i * 1e-3, 1, struct.pack("<q", i)))
    whole = path.read_bytes()
    path.write_bytes(whole[: 2 * len(whole) // 3])
    frames = read_frames(path, BUDGET).frames["0", 1, False]
    assert 3000 < len(frames.stamps) < 9000
    np.testing.assert_array_equal(frames.data.view("<i8").ravel(), np.arange(len(frames.stamps)))


def blf(body: bytes, unpacked: int) -> bytes:
    head = struct.pack("<4sLBBBBBBBBQQLL8H8H72x", b"LOGG", 144, 5, 0, 0, 0, 2, 6, 8, 1, 0, 0, 1, 0, *(0,) * 16)
    container = struct.pack("<H6xL4x", 2, unpacked) + zlib.compress(body, 9)
    return head + struct.pack("<4sHHLL", b"LOBJ", 16, 1, 16 + len(container), 10) + container


def test_a_container_that_is_a_bomb_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.blf"
    path.write_bytes(blf(bytes(200 * 2**20), 100))
    with pytest.raises(InputError, match=r"bomb\.blf: a container that unpacks to 64 MiB, more than 64 MiB"):
        read(path)


def test_a_log_that_starts_in_the_far_future_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "late.blf"
    write_log(path, 1.7e9)
    data = bytearray(path.read_bytes())
    data[40:42] = struct.pack("<H", 9000)  # the year in the header
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match=r"late\.blf: a start 2\.\d+e\+11 s from 1970; expected a date of this century"):
        read(path)


def test_an_object_without_a_size_does_not_hang(tmp_path: Path) -> None:
    payload = struct.pack("<LHHQ", 2, 0, 0, 0) + struct.pack("<HBBL8s", 1, 0, 8, 1, b"")
    path = tmp_path / "loop.blf"
    for version, size in ((1, 0), (0, 0), (1, 15), (1, 2**31)):
        path.write_bytes(blf(struct.pack("<4sHHLL", b"LOBJ", 32, version, size, 1) + payload, 0))
        with pytest.raises(InputError, match=rf"loop\.blf: an object of {size} bytes; expected 16 to 16777216"):
            read(path)


@settings(max_examples=examples(60), deadline=None)
@given(data=st.data())
def test_damage_is_reported_never_a_crash(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("damage")
    path = folder / f"bus{data.draw(st.sampled_from(['.blf', '.asc', '.trc']))}"
    write_log(path, 1.7e9)
    content = bytearray(path.read_bytes())
    anywhere = st.integers(0, 2**20)  # a text log carries today's date: its length differs from run to run
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(anywhere) % len(content)] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: 1 + data.draw(anywhere) % len(content)])
    message, log = "", FrameLog()
    try:
        log = read_frames(path, BUDGET)
    except InputError as error:
        message = str(error)
    assert str(path) in message or not message
    assert all(len(frames.stamps) == len(frames.data) == len(frames.lengths) for frames in log.frames.values())


#: File → data frames it holds, or why it is refused.
REAL: dict[str, int | str] = {
    "issue_1256.asc": 1457,
    "issue_1299.asc": 4,
    "issue_1905.blf": 22,
    "logfile.asc": 12,
    "logfile_errorframes.asc": 7,
    "single_frame.asc": 1,
    "single_frame_us_locale.asc": 1,
    "test_CanErrorFrameExt.blf": "nothing but 2 error frames",
    "test_CanErrorFrames.asc": "nothing but 4 error frames",
    "test_CanFdMessage.asc": 3,
    "test_CanFdMessage.blf": 2,
    "test_CanFdMessage64.asc": 2,
    "test_CanFdMessage64.blf": "nothing but 2 remote frames",
    "test_CanFdRemoteMessage.asc": "nothing but 1 remote frame",
    "test_CanMessage.asc": 2,
    "test_CanMessage.blf": 2,
    "test_CanMessage.trc": 2,
    "test_CanMessage2.blf": 2,
    "test_CanMessage_V1_0_BUS1.trc": 10,
    "test_CanMessage_V1_1.trc": 10,
    "test_CanMessage_V1_3.trc": 10,
    "test_CanMessage_V2_0_BUS1.trc": 10,
    "test_CanMessage_V2_1.trc": 10,
    "test_CanRemoteMessage.asc": "nothing but 3 remote frames",
}


@pytest.mark.parametrize("name", REAL)
def test_real_logs_are_read_or_refused_with_the_reason(name: str, shared_data: Path) -> None:
    expected = REAL[name]
    path = shared_data / "can_logs" / name
    if isinstance(expected, str):
        with pytest.raises(InputError, match=expected):
            read(path)
    else:
        assert sum(len(stream) for stream in read(path).values()) == expected


def test_no_real_log_is_forgotten(shared_data: Path) -> None:
    logs = {path.name for path in (shared_data / "can_logs").iterdir() if path.suffix not in (".dbc", ".mf4")}
    assert logs == set(REAL)
