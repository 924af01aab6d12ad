"""The flight log: every input, output, decision and verdict of a run, on the disk within a second.

A thread writes the cycles of the loop. The file is a recording that ``sysid ingest`` reads without changes:

    LOGS/recipe.toml, machine.toml …       written once
    LOGS/motion-20260503T141500/flight.mcap
    LOGS/poses-20260503T160210/flight.mcap   of the collection of poses

A killed run loses at most one second. A full or slow disk is a fault (:attr:`FlightLog.fault`) to which the loop reacts by its
recipe; the loop never waits.
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
from sysid_rl.run.cycle import Cycle
from sysid_rl.run.flight_messages import COMMANDS, READINGS, MessagePublisher
from sysid_rl.run.mcap_pieces import PieceWriter

#: Seconds between two syncs, and most cycles in the queue.
SYNC_EVERY, WAITING = 1.0, 3000
#: Free space that must remain on the disk [bytes]: some minutes of a run, and a reserve for the user.
RESERVE = 64 * 2**20
#: Longest wait at the end of a log for a disk that does not respond [s].
CLOSE_S = 10.0
#: Real-time priority of the thread, if permitted.
PRIORITY = 5
Kind = Literal["motion", "poses"]


class FlightLog:
    """The log of one run, a context manager; :meth:`record` may be called from one thread.

    Args:
        root: the folder LOGS.
        machine: ``machine.toml``; copied beside the recipe, with its URDF.
        axes, signals: of the transport.
        metadata: of the run, by group: recipe, versions and checksums (:func:`provenance`).
        kind: of the recording for ``sysid ingest``.
        clock_ns: of the loop now; stamps are dates, by an offset that is fixed here.
        reserve: less free space than this is a fault [bytes].

    Raises:
        StorageError: no space, or a folder that cannot be written.
        SettingsError: a folder with logs of another machine.
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
        #: Cycles lost because the queue was full, and cycles written.
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
        """Take a cycle without waiting. With a full queue it is lost, and the log has a fault from then on."""
        if self._queue.qsize() >= WAITING:
            self.lost += 1
            self._fault = self._fault or f"flight log: the disk is too slow, {WAITING} cycles wait"
            return
        self._queue.put(cycle)

    def add_metadata(self, group: str, values: Mapping[str, str]) -> None:
        """Add metadata that is known only at the end of the run; :meth:`close` writes it."""
        self._final_metadata.append((group, dict(values)))

    @property
    def fault(self) -> str:
        """Why it cannot record; "" while it records."""
        return self._fault

    def close(self) -> None:
        """Write the queue and the end of the file; a file without a cycle is removed. May be called again.

        Raises:
            StorageError: the disk fails. Everything synced before stays.
        """
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join(CLOSE_S)
            if self._thread.is_alive():
                found = f"the disk does not respond for {CLOSE_S:g} s"
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
        """The thread: one cycle at a time, so that it holds the interpreter for less than a millisecond."""
        # Priority above other processes, which could preempt it while it holds the interpreter, and below the loop.
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
    """Metadata of a run: sha256 of ``files`` by their roles, model ``versions``, and software versions.

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
    """Write the description of the machine and the ingest recipe beside the recordings.

    Raises:
        StorageError: the disk fails.
        SettingsError: the folder has logs of another machine.
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
        "# Flight logs of the runner.",
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
    """A new folder named after the time."""
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
