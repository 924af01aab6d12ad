"""Cycles of a runner that goes nowhere in particular. As a script it writes a log of them until it is killed."""

from __future__ import annotations

import math
import resource
import sys
import time
from pathlib import Path

import numpy as np

from sysid_rl.run.cycle import Cycle, Violation
from sysid_rl.run.flight_log import FlightLog
from sysid_rl.run.transport import MachineInputs, Measurement

ROOT = Path(__file__).parents[2]
MACHINE = ROOT / "datasets/autolog/machine.toml"
AXES = ("slew", "boom", "stick", "telescope")
SIGNALS = ("slew.joint", "boom.cylinder", "stick.cylinder", "telescope.joint")
NAN = float("nan")


def cycle(number: int, begin_ns: int = 0, verdicts: tuple[Violation, ...] = ()) -> Cycle:
    """The turn ``number`` of a loop at 100 Hz: everything swings."""
    at = begin_ns + number * 10_000_000
    phase = 2.0 * math.pi * number / 400
    swing = math.sin(phase)
    values = (0.5 * swing, 0.05 + 0.02 * swing, 0.06 + 0.02 * math.cos(phase), 0.1 + 0.05 * swing)
    readings = {
        signal: Measurement(value, at - 2_000_000, at - 1_000_000, number + 1)
        for signal, value in zip(SIGNALS, values, strict=True)
    }
    commands = np.array([0.5 * math.cos(phase), 0.4 * math.cos(phase), -0.3 * math.sin(phase), 0.2])
    return Cycle(
        number, at, at - 50_000, "running", MachineInputs(True, False, ""), readings, np.array(values), np.full(3, NAN),
        np.array([0.8, 0.0, 0.3]), np.array(values), np.array(values), np.array(values), commands, commands, True, verdicts,
        "policy", 50_000, 700_000,
    )  # fmt: skip


def main() -> None:
    """Cycles in real time, as fast as ``rate``, into the folder of the first argument."""
    folder, rate, limit = Path(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
    if limit:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    log = FlightLog(folder, MACHINE, AXES, SIGNALS, {"versions": {"policy": "autolog@1"}})
    begin = time.monotonic_ns()
    for number in range(100_000):
        log.record(cycle(number, begin))
        if number % 50 == 0 or log.fault:
            sys.stdout.write(f"{number} {log.fault}\n")
            sys.stdout.flush()
        if log.fault:
            log.close()
        time.sleep(1.0 / rate)


if __name__ == "__main__":
    main()
