"""A simulated test bench in its own process, for tests that speak with it over its serial line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from simulated_bench.live import read_truth
from sysid_rl.run.can import CanSettings

ROOT = Path(__file__).parents[2]
DATABASE = ROOT / "rl/autolog/machine.dbc"
SIGNALS = {
    "slew.joint": "SLEW_SENSOR.slew",
    "boom.cylinder": "DRAW_WIRES.boom",
    "stick.cylinder": "DRAW_WIRES.stick",
    "telescope.joint": "DRAW_WIRES.telescope",
}
VALVES = {axis: f"AUX_VALVE_{k}_COMMAND" for k, axis in enumerate(("slew", "boom", "stick", "telescope"))}


def old_database(folder: Path) -> Path:
    """The demo's database as it was before commands had a stamp and the status an echo."""
    lines = DATABASE.read_text("utf-8").splitlines(keepends=True)
    path = folder / "old.dbc"
    path.write_text("".join(line for line in lines if " stamp " not in line and " echo " not in line), "utf-8")
    return path


@dataclass
class Live:
    """A machine that runs."""

    folder: Path
    process: subprocess.Popen[str]

    @property
    def settings(self) -> CanSettings:
        return CanSettings(
            DATABASE, SIGNALS, VALVES, channel=str(self.folder / "can0"), control=self.folder / "control", listen=0.15
        )

    @property
    def truth(self):  # type: ignore[no-untyped-def]
        return read_truth(self.folder / "truth.bin")

    def tell(self, line: str) -> None:
        with (self.folder / "control").open("w") as pipe:
            pipe.write(line + "\n")

    def kill(self) -> None:
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.wait()


@contextmanager
def live_machine(folder: Path, *options: str) -> Iterator[Live]:
    """The crane of the demo in real time, ready to be spoken with; it ends with the block."""
    words = [sys.executable, "-m", "simulated_bench", "live", str(ROOT / "datasets/autolog/bench.toml"), "--seconds", "120"]
    words += ["--database", str(DATABASE), "--pty", str(folder / "can0"), "--control", str(folder / "control")]
    words += ["--truth", str(folder / "truth.bin"), *options]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "pipelines")))}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline().startswith("ready")
            yield Live(folder, process)
        finally:
            process.kill()
