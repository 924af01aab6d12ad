"""The flight log: every input, output, decision and verdict of a run, on the disk within a second.

The loop hands over cycles and goes on; a thread writes them. The file is a recording that ``sysid ingest`` takes as it is:

    LOGS/recipe.toml, machine.toml …       written once
    LOGS/motion-20260503T141500/flight.mcap
    LOGS/poses-20260503T160210/flight.mcap   of the collection of poses

A run that was killed leaves what was synced, a second at the most missing. A disk that is full, or too slow, is a fault that
the loop sees (:attr:`FlightLog.fault`) and reacts to by its recipe; it never waits.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import shutil
import threading
import time
import tomllib
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Literal

from sysid.errors import SettingsError, StorageError
from sysid.files import write_durably
from sysid.release import __version__
from sysid.runner.cycle import Cycle
from sysid.runner.flight_messages import COMMANDS, READINGS, MessagePublisher
from sysid.runner.mcap_pieces import PieceWriter

#: Seconds between two syncs, and how many cycles may wait to be written.
SYNC_EVERY, WAITING = 1.0, 3000
#: Room that has to be left on the disk [bytes]: some minutes of a run, and a little for whoever has to make room.
RESERVE = 64 * 2**20
#: Longest that the end of a log waits for a disk that does not answer [s].
CLOSE_S = 10.0
#: Real-time priority of the thread, where it is permitted.
PRIORITY = 5
Kind = Literal["motion", "poses"]


class FlightLog:
    """The log of one run, a context manager; :meth:`record` may be called from one thread.

    Args:
        root: the folder LOGS.
        machine: ``machine.toml``; copied beside the recipe, with its URDF.
        axes, signals: of the transport.
        words: of the run, by group: its recipe, versions and checksums of everything that runs (:func:`provenance`).
        kind: what the recording is to ``sysid ingest``.
        clock_ns: of the loop now; the log is stamped with the date, by an offset taken once.
        reserve: less room than this on the disk is a fault [bytes].

    Raises:
        StorageError: no room, or a folder that cannot be written.
        SettingsError: a folder of another machine's logs.
    """

    def __init__(
        self,
        root: Path,
        machine: Path,
        axes: tuple[str, ...],
        signals: tuple[str, ...],
        metadata: Mapping[str, Mapping[str, str]],
        *,
        kind: Kind = "motion",
        clock_ns: int | None = None,
        reserve: int = RESERVE,
    ) -> None:
        now = time.time_ns()
        self.folder = _recording(root, kind, now)
        self.path = self.folder / "flight.mcap"
        self._reserve = reserve
        if (free := shutil.disk_usage(self.folder).free) < reserve:
            self.folder.rmdir()
            raise StorageError(
                f"flight log {root}", f"{free / 2**20:.0f} MiB free", f"{reserve / 2**20:.0f} MiB", "Make room on the disk."
            )
        write_description(root, machine, axes, signals)
        self._publisher = MessagePublisher(axes, now - (time.monotonic_ns() if clock_ns is None else clock_ns))
        self._queue: SimpleQueue[Cycle | None] = SimpleQueue()
        self._final_metadata: list[tuple[str, dict[str, str]]] = []
        self._fault = ""
        self._broken = False
        #: Cycles that found no place in the queue, and those that were written.
        self.lost = self.written = 0
        try:
            self._writer = PieceWriter(self.path, "ros2", f"sysid {__version__}")
            self._channels = {
                topic: self._writer.channel(topic, kind_, text) for topic, kind_, text in self._publisher.topics(signals)
            }
            for group, values in metadata.items():
                self._writer.metadata(group, values)
            self._writer.sync()
        except OSError as error:
            raise _storage(self.path, error) from error
        self._thread = threading.Thread(target=self._write, name="flight log", daemon=True)
        self._thread.start()

    def record(self, cycle: Cycle) -> None:
        """Take a cycle; never waits. One that finds the queue full is counted, and the log is at fault from then on."""
        if self._queue.qsize() >= WAITING:
            self.lost += 1
            self._fault = self._fault or f"flight log: the disk is too slow, {WAITING} cycles wait"
            return
        self._queue.put(cycle)

    def add_metadata(self, group: str, values: Mapping[str, str]) -> None:
        """Words about the run that are known only when it is over: written at the end, before :meth:`close` returns."""
        self._final_metadata.append((group, dict(values)))

    @property
    def fault(self) -> str:
        """What keeps it from recording; "" while it records."""
        return self._fault

    def close(self) -> None:
        """Write what waits, and the end of the file; one without a cycle is taken away. May be called again.

        Raises:
            StorageError: that cannot be written. What was synced before is there.
        """
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join(CLOSE_S)
            if self._thread.is_alive():
                found = f"the disk does not answer for {CLOSE_S:g} s"
                raise StorageError(str(self.path), found, "a disk that writes", f"{self.written} cycles are written.")
            if not (self.written or self._broken):
                self.path.unlink(missing_ok=True)
                self.folder.rmdir()
        if self._broken:
            raise StorageError(str(self.path), self._fault, "room on the disk", f"{self.written} cycles are written.")

    def __enter__(self) -> FlightLog:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _write(self) -> None:
        """The thread: one cycle at a time, so that it holds the interpreter for a fraction of a millisecond only."""
        # A thread that other processes push aside while it holds the interpreter holds up the loop: above them, below the loop.
        with contextlib.suppress(OSError, AttributeError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        synced = time.monotonic()
        cycles = 0
        done = False
        while not done:
            cycle: Cycle | None = None
            try:
                cycle = self._queue.get(timeout=0.1)
                done = cycle is None
            except Empty:
                pass
            try:
                if cycle is not None and not self._broken:
                    self._publish(cycle)
                    cycles += 1
                if not self._broken and (done or time.monotonic() - synced >= SYNC_EVERY):
                    self._writer.sync()
                    synced = time.monotonic()
                    self.written = cycles
                    if not done and shutil.disk_usage(self.folder).free < self._reserve:
                        self._fault = self._fault or f"flight log: less than {self._reserve / 2**20:.0f} MiB left on the disk"
            except OSError as error:
                self._broken = True
                self._fault = f"flight log: {error.strerror or error}"
        try:
            if self.lost:
                self._writer.metadata("lost", {"cycles": str(self.lost)})
            for group, values in self._final_metadata:
                self._writer.metadata(group, values)
            self._writer.finish()
        except OSError as error:
            self._broken = True
            self._fault = f"flight log: {error.strerror or error}"
        self._writer.close()

    def _publish(self, cycle: Cycle) -> None:
        for message in self._publisher.messages(cycle):
            channel = self._channels.get(message.topic)
            if channel is not None:
                self._writer.message(channel, cycle.number, message.log_ns, message.publish_ns, message.data)


def provenance(files: Mapping[str, Path], versions: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """Words of a run: sha256 of ``files`` by what they are, ``versions`` of what ran, and the software underneath.

    Raises:
        OSError: a file cannot be read.
    """
    from importlib.metadata import version

    software = {name: version(name) for name in ("numpy", "scipy", "mcap", "python-can", "cantools")}
    software |= {"sysid": __version__, "python": platform.python_version(), "system": platform.platform()}
    return {
        "sha256": {what: hashlib.sha256(path.read_bytes()).hexdigest() for what, path in files.items()},
        "versions": dict(versions),
        "software": software,
    }


def write_description(root: Path, machine: Path, axes: tuple[str, ...], signals: tuple[str, ...]) -> None:
    """Put the description of the machine and the recipe that maps a flight log beside the recordings.

    Raises:
        StorageError: the disk. SettingsError: the folder has logs of another machine.
    """
    own = root / "machine.toml"
    text = machine.read_bytes()
    if own.exists() and own.read_bytes() != text:
        raise SettingsError(
            str(root), f"holds logs of another machine than {machine}", "a folder for the logs of this one", "Name another."
        )
    room = "Make room, or name another folder for logs."
    urdf = tomllib.loads(text.decode()).get("urdf")
    if urdf is not None and not (root / urdf).exists():
        write_durably(root / urdf, (machine.parent / urdf).read_bytes(), "description", room)
    write_durably(own, text, "description", room)
    write_durably(root / "recipe.toml", recipe_text(root, axes, signals).encode(), "recipe", room)


def recipe_text(root: Path, axes: tuple[str, ...], signals: tuple[str, ...]) -> str:
    """The ingest recipe of the flight logs in ``root``."""
    kinds = [kind for kind in ("motion", "poses") if any(root.glob(f"{kind}-*"))]
    lines = [
        "# Flight logs of the runner, as they are.",
        "schema = 1",
        'machine = "machine.toml"',
        "",
        "[recordings]",
        *(f'{kind} = ["{kind}-*"]' for kind in kinds),
        "",
        "[[streams]]",
        'files = "flight.mcap"',
        'reader = "mcap"',
        'clock = "header"',
        'domain = "machine"',
        "[streams.signals]",
        *(f'"{axis}.command" = {{ topic = "{COMMANDS}", field = "command[{axis}]" }}' for axis in axes),
        *(f'"{signal}" = {{ topic = "{READINGS}{signal}", field = "value" }}' for signal in signals),
    ]
    return "\n".join(lines) + "\n"


def _recording(root: Path, kind: Kind, now_ns: int) -> Path:
    """A new folder of this moment."""
    moment = datetime.fromtimestamp(now_ns // 1_000_000_000, UTC)
    name = f"{kind}-{moment:%Y%m%dT%H%M%S}"
    try:
        root.mkdir(parents=True, exist_ok=True)
        for count in range(1000):
            folder = root / (name if count == 0 else f"{name}-{count}")
            if not folder.exists():
                folder.mkdir()
                return folder
    except OSError as error:
        raise _storage(root, error) from error
    raise StorageError(str(root), f"a thousand recordings called {name}", "one or two a second")


def _storage(path: Path, error: OSError) -> StorageError:
    return StorageError(f"flight log {path}", error.strerror or str(error), "a folder that can be written", "")
