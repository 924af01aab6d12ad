"""Flight logs of a lift whose valve has a dead-band, as the runner writes them."""

from __future__ import annotations

import time
from pathlib import Path
from unittest import mock

import numpy as np
from fleet_logs import MACHINE, RATE, recorded

from sysid_rl.run import flight_log
from sysid_rl.run.cycle import Cycle
from sysid_rl.run.flight_log import FlightLog
from sysid_rl.run.transport import MachineInputs, Measurement

#: Most cycles in a piece of the log, and seconds from one piece to the next.
PIECE, SYNC_EVERY = 100, 0.01


def fly(folder: Path, band: float, seed: int) -> Path:
    """Write one flight log below ``folder``/flights; returns its file."""
    machine = folder / "machine.toml"
    folder.mkdir(exist_ok=True)
    if not machine.exists():
        machine.write_text(MACHINE)
    table = recorded(band, seed)
    log = FlightLog(folder / "flights", machine, ("boom",), ("boom.joint",), {}, clock_ns=0)
    # The loop is much faster than a real one: as many pieces as if it were not, on a busy computer too.
    with mock.patch.object(flight_log, "SYNC_EVERY", SYNC_EVERY), log:
        for number, (command, joint) in enumerate(zip(table["boom.command"], table["boom.joint [rad]"], strict=True)):
            if number % PIECE == PIECE - 1:
                time.sleep(1.2 * SYNC_EVERY)  # the writer syncs with this cycle, instead of a tenth of a second after it
            log.record(cycle(number, float(command), float(joint)))
            while number % PIECE == PIECE - 1 and log.written <= number and not log.fault:
                time.sleep(0.002)
    return log.path


def cycle(number: int, command: float, joint: float) -> Cycle:
    """The cycle ``number`` of a loop that sends and measures what it is given."""
    at = round(number * 1e9 / RATE)
    place, sent, nowhere = np.array([joint]), np.array([command]), np.full(3, np.nan)
    readings = {"boom.joint": Measurement(joint, at, at, number + 1)}
    return Cycle(
        number, at, at, "running", MachineInputs(True, False, ""), readings, place, nowhere, nowhere, place,
        place, place, sent, sent, True, (), "policy", 50_000, 700_000,
    )  # fmt: skip


def interrupt(path: Path, share: float) -> None:
    """Leave of a log what a runner that was killed after ``share`` of it has written."""
    content = path.read_bytes()
    path.write_bytes(content[: round(share * len(content))])
