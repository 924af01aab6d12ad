"""MDF 4: measured channels, logged CAN frames, damage."""

from __future__ import annotations

from pathlib import Path

import can
import numpy as np
import pytest
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from small_logs import write_log

from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream, reader_for
from sysid.logs.can_frames import read_frames
from sysid.logs.limits import Budget

pytest.importorskip("asammdf", reason="the extra that reads MDF files is not installed")


def read(path: Path, *streams: str) -> dict[str, Stream]:
    options = ReadOptions(streams=frozenset(streams) or None)
    return {stream.name: stream for stream in reader_for(path).read(path, options)}


def test_channel_groups_of_a_measurement_become_streams(tmp_path: Path) -> None:
    from asammdf import MDF, Signal

    time = 0.01 * np.arange(50)
    path = tmp_path / "run.mf4"
    with MDF() as mdf:
        length = Signal(np.arange(50) * 0.5, time, name="boom", unit="mm")
        count = Signal(np.arange(50, dtype=np.uint8), time, name="count")
        words = Signal(np.array([b"on"] * 50), time, name="mode", encoding="utf-8")
        mdf.append([length, count, words], acq_name="wires")
        mdf.append([Signal(np.ones(7), np.arange(7.0), name="level", unit="%")], acq_name="tank")
        mdf.save(path)
    streams = read(path)
    assert set(streams) == {"wires", "tank"}
    wires = streams["wires"]
    np.testing.assert_array_equal(wires.columns["boom"], np.arange(50) * 0.5)
    np.testing.assert_array_equal(wires.columns["count"], np.arange(50))
    assert wires.units == {"boom": "mm"}
    assert wires.losses == ("run.mf4: wires: no numbers in mode",)
    np.testing.assert_array_equal(np.diff(wires.stamps["log"]), 10_000_000)
    assert set(read(path, "tank")) == {"tank"}
    with pytest.raises(InputError, match=r"no channel group 'tang'; expected 'tank'\?"):
        read(path, "tang")


def test_logged_frames_are_those_of_the_same_log_in_another_format(tmp_path: Path) -> None:
    writers = [can.MF4Writer(tmp_path / "bus.mf4"), can.BLFWriter(tmp_path / "bus.blf")]
    for writer in writers:
        for i in range(30):
            extended = i % 3 == 0
            identifier = 0x18FF5027 if extended else 0x1A7
            payload = bytes(range(i, i + (4 if extended else 8)))
            writer.on_message_received(
                can.Message(
                    timestamp=1.7e9 + 0.01 * i, arbitration_id=identifier, is_extended_id=extended, data=payload, channel=0
                )
            )
        writer.stop()
    found = read(tmp_path / "bus.mf4")
    assert set(found) == {"0x1A7", "0x18FF5027x"}
    for (_, identifier, extended), frames in read_frames(tmp_path / "bus.blf", Budget.of(10_000)).frames.items():
        stream = found[f"0x{identifier:X}{'x' if extended else ''}"]
        np.testing.assert_array_equal(np.column_stack(list(stream.columns.values())), frames.data)
        np.testing.assert_allclose(stream.stamps["log"] - stream.stamps["log"][0], frames.stamps - frames.stamps[0], atol=1000)


SYNC = {1: "time", 2: "an angle", 3: "a distance", 4: "an index"}


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kinds=st.lists(st.sampled_from(sorted(SYNC)), min_size=1, max_size=4), data=st.data())
def test_only_time_is_a_clock(tmp_path: Path, kinds: list[int], data: st.DataObject) -> None:
    """Groups over an angle, a distance or an index are named and left out; one that the recipe asks for is refused."""
    from asammdf import MDF, Signal

    path = tmp_path / "sync.mf4"
    with MDF() as mdf:
        for number, kind in enumerate(kinds):
            master = ("t" if kind == 1 else "m", kind)
            mdf.append([Signal(np.arange(5.0), np.arange(5.0), name="a", master_metadata=master)], acq_name=f"g{number}")
        mdf.save(path, overwrite=True)
    others = [f"g{number}" for number, kind in enumerate(kinds) if kind != 1]
    if len(others) == len(kinds):
        with pytest.raises(InputError, match=rf"sync\.mf4: g0: its master channel 'm' is {SYNC[kinds[0]]}, not time"):
            read(path)
        return
    streams = read(path)
    assert sorted(streams) == [f"g{number}" for number, kind in enumerate(kinds) if kind == 1]
    said = [f"g{n}: its master channel 'm' is {SYNC[kind]}, not time" for n, kind in enumerate(kinds) if kind != 1]
    for stream in streams.values():
        assert stream.losses == tuple(f"sync.mf4: {text}: left out" for text in said)
    if others:
        with pytest.raises(InputError, match=rf"sync\.mf4: {others[0]}: its master channel"):
            read(path, others[0])


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(marks=st.lists(st.booleans(), min_size=2, max_size=12))
def test_samples_that_are_marked_invalid_are_missing_and_counted(tmp_path: Path, marks: list[bool]) -> None:
    from asammdf import MDF, Signal

    path = tmp_path / "marks.mf4"
    time = 0.1 * np.arange(len(marks))
    with MDF() as mdf:
        first = Signal(np.arange(len(marks)), time, name="a", invalidation_bits=np.array(marks))
        mdf.append([first, Signal(np.ones(len(marks)), time, name="b")], acq_name="g")
        mdf.save(path, overwrite=True)
    (stream,) = read(path).values()
    np.testing.assert_array_equal(stream.columns["a"], np.where(marks, np.nan, np.arange(len(marks))))
    assert np.isfinite(stream.columns["b"]).all()
    text = f"marks.mf4: g: samples that the file marks as invalid are missing: a {sum(marks)}"
    assert stream.losses == ((text,) if any(marks) else ())


def test_frames_beside_channels_are_said(tmp_path: Path) -> None:
    from asammdf import MDF, Signal

    writer = can.MF4Writer(tmp_path / "bus.mf4")
    for i in range(3):
        writer.on_message_received(
            can.Message(timestamp=1.7e9 + i, arbitration_id=256, is_extended_id=False, data=b"\1\2", channel=0)
        )
    writer.stop()
    with MDF(tmp_path / "bus.mf4") as mdf:
        mdf.append([Signal(np.arange(3.0), np.arange(3.0), name="a")], acq_name="wires")
        mdf.save(tmp_path / "both.mf4")
    streams = read(tmp_path / "both.mf4")
    assert "wires" in streams
    assert any("logged CAN frames of 1 groups, which need `dbc`: left out" in loss for loss in streams["wires"].losses)
    dbc = tmp_path / "m.dbc"
    dbc.write_text('VERSION ""\nBS_:\nBU_: ECU\nBO_ 256 M: 2 ECU\n SG_ s : 0|16@1+ (1,0) [0|0] "" ECU\n')
    (message,) = reader_for(tmp_path / "both.mf4").read(tmp_path / "both.mf4", ReadOptions(dbc=dbc))
    assert message.name == "M"
    assert message.losses == ("both.mf4: channel groups beside the CAN frames left out: wires",)


@pytest.mark.parametrize(("content", "reason"), [(b"", "empty"), (b"hello, this is text", "starts with b'hello, t'")])
def test_what_is_no_mdf_file_is_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "run.mf4"
    path.write_bytes(content)
    with pytest.raises(InputError, match=reason):
        read(path)


def test_a_cut_off_file_is_refused_by_name(shared_data: Path, tmp_path: Path) -> None:
    path = tmp_path / "cut.mf4"
    path.write_bytes((shared_data / "can_logs" / "test_batch.mf4").read_bytes()[:700])
    with pytest.raises(InputError, match=r"cut\.mf4: not readable as MDF 4 \("):
        read(path)


def test_real_measurements(shared_data: Path) -> None:
    demo = read(shared_data / "can_logs" / "ASAP2_Demo_V171.mf4")
    lengths = {name: len(stream) for name, stream in demo.items() if "Calibration" not in name}
    engines = dict.fromkeys(("Engine_1", "Engine_2", "Engine_3", "Leading_All"), 12402)
    assert lengths == {"100ms_sync": 124, "10ms_sync": 1240, **engines}
    assert demo["10ms_sync"].units["ASAM.M.SCALAR.UBYTE.FORM_X_PLUS_4"] == "rpm"
    np.testing.assert_allclose(np.diff(demo["100ms_sync"].stamps["log"]), 100_000_000, atol=1000)
    (batch,) = read(shared_data / "can_logs" / "test_batch.mf4").values()
    assert (len(batch), len(batch.columns)) == (1051, 3)


def test_a_chain_of_blocks_without_an_end_is_refused(tmp_path: Path) -> None:
    path = write_log(tmp_path, "log.mf4")
    data = bytearray(path.read_bytes())
    assert list(read(path)) == ["wires"]
    channels = [at for at in range(0, len(data), 8) if data[at : at + 4] == b"##CN"]
    data[channels[-1] + 24 : channels[-1] + 32] = channels[0].to_bytes(8, "little")
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match=rf"log\.mf4: two links to the block at byte {channels[0]}; expected chains"):
        read(path)


def test_a_channel_outside_of_its_record_is_refused(tmp_path: Path) -> None:
    path = write_log(tmp_path, "log.mf4")
    data = bytearray(path.read_bytes())
    (place,) = [at for at in range(0, len(data), 8) if data[at : at + 4] == b"##CG"]
    links = int.from_bytes(data[place + 16 : place + 24], "little")
    record = place + 24 + 8 * links + 24  # record id, cycles, flags, separator, reserved; then bytes of a record
    assert int.from_bytes(data[record : record + 4], "little") == 16
    channel = [at for at in range(0, len(data), 8) if data[at : at + 4] == b"##CN"][-1]
    offset = channel + 24 + 8 * int.from_bytes(data[channel + 16 : channel + 24], "little") + 4
    data[offset : offset + 4] = (1000).to_bytes(4, "little")
    path.write_bytes(bytes(data))
    with pytest.raises(
        InputError, match=r"wires: channel 'ramp' in bytes 1000 to 1008; expected a place in a record of 16 bytes"
    ):
        read(path)


def test_a_database_for_a_log_without_frames_is_refused(tmp_path: Path) -> None:
    path = write_log(tmp_path, "log.mf4")
    with pytest.raises(
        InputError, match=r"log\.mf4: no logged CAN frames; expected frames that x\.dbc describes\. Leave `dbc` out"
    ):
        reader_for(path).read(path, ReadOptions(dbc=tmp_path / "x.dbc"))
