"""The slcan reader on a pseudo-terminal: any byte, answers of adapters between the frames, adapters that take nothing."""

from __future__ import annotations

import contextlib
import os
import time
import tty
from collections.abc import Iterator

import can
import numpy as np
import pytest
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from live_machine import DATABASE, SIGNALS, VALVES

from simulated_bench.live_bus import CanFrame, LiveBus
from sysid_rl.run.can import CanSettings, CanTransport
from sysid_rl.run.slcan import WAITING, SlcanBus, parse_line

pytestmark = pytest.mark.realtime

GOOD = b"t12A3010203\r"
STATUS = {"dead_man": 1.0, "emergency_stop": 0.0, "fault": 0.0, "echo": 0.0}
READINGS = {"slew.joint": 0.1, "boom.cylinder": 0.05, "stick.cylinder": 0.06, "telescope.joint": 0.1}


class Adapter:
    """The other end of a serial line."""

    def __init__(self) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        tty.setraw(self.master)
        os.set_blocking(self.master, False)
        self.channel = os.ttyname(self._slave)

    def say(self, data: bytes) -> None:
        os.write(self.master, data)

    def heard(self) -> bytes:
        with contextlib.suppress(BlockingIOError):
            return os.read(self.master, 65536)
        return b""

    def close(self) -> None:
        for end in (self.master, self._slave):
            with contextlib.suppress(OSError):
                os.close(end)


@pytest.fixture
def adapter() -> Iterator[Adapter]:
    found = Adapter()
    yield found
    found.close()


@pytest.fixture
def bus(adapter: Adapter) -> Iterator[SlcanBus]:
    found = SlcanBus(adapter.channel, bitrate=250_000, sleep_after_open=0.0, timeout=0.0)
    yield found
    with contextlib.suppress(can.CanError):
        found.shutdown()


def frames(bus: SlcanBus, count: int = 1) -> list[can.Message]:
    """What comes until ``count`` frames are there, or a second is over, and what waits behind them."""
    found: list[can.Message] = []
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        frame = bus.recv(0)
        if frame is not None:
            found.append(frame)
        elif len(found) >= count:
            break
        else:
            time.sleep(0.001)
    return found


@pytest.mark.parametrize(
    "noise",
    [b"T1\r", b"t1\r", b"d1\r", b"D\r", b"x\r", b"r\r", b"T0000000\r", b"t12A9\r", b"t12A801\r", b"tFFF0\r", b"TFFFFFFFF0\r",
     b"\xff\xfe\r", b"z\r", b"Z\r", b"\r", b"\a", b"V1013\rNA123\rF00\r", b"\x00" * 500 + b"\r", b"t" * 5000 + b"\r"],
)  # fmt: skip
def test_what_is_no_frame_hides_none(adapter: Adapter, bus: SlcanBus, noise: bytes) -> None:
    adapter.say(noise + GOOD)
    found = frames(bus)
    assert [(frame.arbitration_id, bytes(frame.data)) for frame in found] == [(0x12A, b"\x01\x02\x03")]


def test_damaged_frames_are_counted_and_answers_are_not(adapter: Adapter, bus: SlcanBus) -> None:
    adapter.say(b"z\rZ\r\r\aT1\rt12A301020\r" + GOOD)
    assert len(frames(bus)) == 1
    assert bus.damaged == 2


def test_answers_between_frames_end_no_reading(adapter: Adapter, bus: SlcanBus) -> None:
    """python-can gives nothing for an answer, and whoever reads until nothing comes falls behind by a frame at each."""
    adapter.say((b"z\r" * 4 + GOOD) * 50)
    time.sleep(0.05)
    taken = 0
    while bus.recv(0) is not None:
        taken += 1
    assert taken == 50


@pytest.mark.parametrize(
    ("line", "identifier", "data"),
    [(b"t7FF0", 0x7FF, b""), (b"T1FFFFFFF2aBcD", 0x1FFFFFFF, b"\xab\xcd"),
     (b"x000000011FF", 1, b"\xff"), (b"t00110A1234", 1, b"\x0a")],
)  # fmt: skip
def test_lines_that_are_frames(line: bytes, identifier: int, data: bytes) -> None:
    """The last one has the adapter's own stamp."""
    frame = parse_line(line)
    assert frame is not None
    assert (frame.arbitration_id, bytes(frame.data), frame.is_extended_id) == (identifier, data, line[:1] in b"Tx")


@given(st.integers(0, 2**29 - 1), st.booleans(), st.binary(max_size=8))
def test_what_the_machine_says_is_understood(identifier: int, extended: bool, data: bytes) -> None:
    said = CanFrame(identifier if extended else identifier % 2048, extended, data)
    frame = parse_line(said.line()[:-1])
    assert frame is not None
    assert (frame.arbitration_id, frame.is_extended_id, bytes(frame.data)) == (said.identifier, extended, data)


@given(st.binary(max_size=60))
def test_any_line_is_a_whole_frame_or_none(line: bytes) -> None:
    frame = parse_line(line)
    assert frame is None or frame.dlc == len(frame.data) <= 8


def connected(adapter: Adapter, kind: type[SlcanBus] = SlcanBus) -> CanTransport:
    settings = CanSettings(DATABASE, SIGNALS, VALVES, channel=adapter.channel, listen=0.0)
    return CanTransport(settings, bus=kind(adapter.channel, bitrate=250_000, sleep_after_open=0.0, timeout=0.0))


@pytest.fixture(scope="module")
def machine() -> Iterator[tuple[Adapter, CanTransport, LiveBus]]:
    """A transport that listened to a machine, whose end of the line is now the test's."""
    adapter, spoken = Adapter(), LiveBus(DATABASE, survey=False)
    cycle = b"".join(frame.line() for k in range(3) for frame in spoken.frames(READINGS, k, {**STATUS, "time": 0.01 * k}))
    transport = connected(adapter)
    adapter.say(cycle)
    yield adapter, transport, spoken
    transport.close()
    adapter.close()


_PIECES = st.one_of(
    st.binary(max_size=40),
    st.sampled_from(
        [b"T1\r", b"t1\r", b"d1\r", b"z\r", b"Z\r", b"\r", b"\a", GOOD, b"t1A7110\r", b"t1A78\r", b"T0CFF4033812\r"]
    ),
)


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(_PIECES, max_size=8).map(b"".join))
def test_no_byte_ends_the_reading(machine: tuple[Adapter, CanTransport, LiveBus], noise: bytes) -> None:
    """Whatever came before, what comes behind the next end of a line is read, and no noise is a fault of the line."""
    adapter, transport, spoken = machine
    before = {signal: reading.count for signal, reading in transport.read()[0].items()}
    said = b"".join(frame.line() for frame in spoken.frames(READINGS, 1, {**STATUS, "time": time.monotonic() % 1e5}))
    adapter.say(noise + b"\r" + said)
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        readings, inputs = transport.read()
        if (
            all(readings[signal].count > before.get(signal, 0) for signal in SIGNALS if signal in readings)
            and len(readings) == 4
        ):
            break
    assert len(readings) == 4
    assert all(readings[signal].count > before.get(signal, 0) for signal in SIGNALS)
    assert not inputs.fault.startswith("bus")
    assert all(np.isfinite(reading.value) for reading in readings.values())


def test_an_adapter_that_acknowledges(adapter: Adapter) -> None:
    """After each frame that it has sent it says so; the machine's frames are all read in the cycle in which they came."""
    spoken = LiveBus(DATABASE, survey=False)
    transport = connected(adapter)
    for turn in range(60):
        transport.write(np.full(4, 0.2), True)
        time.sleep(0.001)
        sent = adapter.heard().count(b"T")
        said = [frame.line() for frame in spoken.frames(READINGS, turn, {**STATUS, "time": 0.01 * turn})]
        adapter.say(b"Z\r\rz\r" * sent + b"z\r".join(said))
        time.sleep(0.002)
        readings, inputs = transport.read()
        if turn > 2:
            assert readings["slew.joint"].count >= turn - 1, "nothing waits for the next cycle"
        assert not inputs.fault.startswith("bus")
    transport.close()


def test_an_adapter_that_takes_nothing_is_a_fault(adapter: Adapter) -> None:
    transport = connected(adapter)

    def until_full() -> None:
        for _ in range(1000):
            transport.write(np.full(4, 0.2), True)

    with pytest.raises(OSError, match="bus: "):
        until_full()
    with pytest.raises(OSError, match="bus: "):
        transport.write(np.zeros(4), False)
    transport.close()


def test_frames_that_wait_in_the_computer_would_come_late(bus: SlcanBus) -> None:
    """Drivers take kilobytes before they refuse: at 27 bytes a frame that is half a second of commands."""
    waits = type("Waits", (type(bus.serialPortOrig),), {"out_waiting": WAITING + 1})
    bus.serialPortOrig.__class__ = waits
    with pytest.raises(can.CanOperationError, match="the adapter takes no frames"):
        bus.send(can.Message(arbitration_id=1, data=b""))


def test_a_receiver_that_fails_leaves_the_sender(adapter: Adapter) -> None:
    """Whatever a driver raises is a fault of the line, and the machine can still be told that nobody commands."""

    class Broken(SlcanBus):
        def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
            raise IndexError("string index out of range")

    transport = connected(adapter, Broken)
    _, inputs = transport.read()
    assert inputs.fault == "bus: string index out of range"
    adapter.heard()
    transport.write(np.full(4, 0.2), True)
    transport.close()
    time.sleep(0.01)
    said = adapter.heard()
    assert said.count(b"T") == 10
    assert b"T0CFF302820" in said, "the last status says that nobody commands"
