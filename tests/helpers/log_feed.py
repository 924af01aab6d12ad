"""Recordings that arrive in a log folder in every way in which files are copied, and a watch that is killed meanwhile."""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from os import mkfifo, utime
from pathlib import Path
from threading import Event

from fleet_logs import RATE, recorded

#: Rows of a recording, and seconds without a change after which it counts as complete.
ROWS, QUIET = 400, 0.3
#: Mends of clocks [s]: a copy keeps the times of a year ago, or has those of a computer whose clock is a year ahead.
CLOCKS = (0.0, -3.2e7, 3.2e7)
#: Calls of the watch until it is killed.
WATCH = """
import sys
from pathlib import Path
from sysid.fleet import watch
watch(sys.argv[1], "lift-1")
print("begins", flush=True)
while True:
    watch(sys.argv[1], "lift-1", [Path(sys.argv[2])], quiet_s=float(sys.argv[3]))
"""


def write_log(path: Path, seed: int, band: float = 0.08) -> None:
    """One recording with absolute stamps, a minute after the one before."""
    table = recorded(band, seed)[:ROWS].assign(time=lambda own: own["time"] + 1.7e9 + 60.0 * seed)
    table["time"] = table["time"].round(round(RATE))
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".parquet":
        table.to_parquet(path, index=False)
    else:
        table.to_csv(path, index=False)


@dataclass
class Feed:
    """Copies recordings from ``source`` to ``target``, each in a random way.

    Args:
        pause: the longest usual pause in a copy [s]; some are ten times as long.
        ended: to be set where the feed is to end before it is done.
    """

    source: Path
    target: Path
    random: random.Random
    pause: float = 5.0 * QUIET
    ways: dict[str, int] = field(default_factory=dict)
    ended: Event = field(default_factory=Event)

    def all(self, names: Sequence[str], threads: int = 8) -> None:
        ordered = [*names]
        self.random.shuffle(ordered)
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(self.one, ordered, [self.random.random() for _ in ordered]))

    def one(self, name: str, seed: float) -> None:
        if self.ended.is_set():
            return
        own = random.Random(seed)
        way: Callable[[str, random.Random], None] = own.choice(
            [self.moved, self.copied, self.renamed, self.repeated, self.replaced, self.cut, self.beside_bad_ones]
        )
        self.ways[way.__name__] = self.ways.get(way.__name__, 0) + 1
        way(name, own)

    def moved(self, name: str, own: random.Random) -> None:
        """All at once."""
        whole = self.target.parent / f"moved-{name}"
        shutil.copytree(self.source / name, whole)
        self._clock(whole, own)
        whole.rename(self.target / name)

    def copied(self, name: str, own: random.Random) -> None:
        """Slowly, with pauses that may be longer than a watch waits."""
        self._copy(name, self.target / name, own)

    def renamed(self, name: str, own: random.Random) -> None:
        """Slowly under another name, then renamed."""
        self._copy(name, self.target / f"incoming-{name}", own)
        self._wait(own)
        (self.target / f"incoming-{name}").rename(self.target / name)

    def repeated(self, name: str, own: random.Random) -> None:
        """Once more, under another name."""
        self._copy(name, self.target / name, own)
        self._wait(own)
        self._copy(name, self.target / f"{name}-copy", own)

    def replaced(self, name: str, own: random.Random) -> None:
        """Another recording of this name, then this one: written over it, or renamed to it."""
        log = next((self.source / name).iterdir())
        path = self.target / name / log.name
        write_log(path, own.randrange(10**6, 2 * 10**6))
        self._wait(own)
        if own.random() < 0.5:
            shutil.copy(log, path)
        else:
            shutil.copy(log, path.with_name(f".{log.name}.x7"))
            path.with_name(f".{log.name}.x7").rename(path)
        self._clock(path.parent, own)

    def cut(self, name: str, own: random.Random) -> None:
        """A part, and after a long time the whole."""
        log = next((self.source / name).iterdir())
        path = self.target / name / log.name
        path.parent.mkdir()
        content = log.read_bytes()
        path.write_bytes(content[: round(own.uniform(0.1, 0.95) * len(content))])
        self._clock(path.parent, own)
        self._wait(own, 10.0)
        path.write_bytes(content)
        self._clock(path.parent, own)

    def beside_bad_ones(self, name: str, own: random.Random) -> None:
        """As :meth:`copied`, beside entries that are no recordings, and one that vanishes."""
        (self.target / f"link-{name}").symlink_to(self.source / name)
        mkfifo(self.target / f"pipe-{name}")
        bad = self.target / f"bad-{name}"
        bad.mkdir()
        (bad / "log.csv").write_bytes(own.randbytes(100))
        odd = self.target / f"odd\n{name}"
        shutil.copytree(self.source / name, odd)
        linked = self.target / f"linked-{name}"
        linked.mkdir()
        (linked / "log.csv").symlink_to("/dev/zero")
        vanishing = self.target / f"vanishing-{name}"
        vanishing.mkdir()
        (vanishing / "log.csv").write_text("time\n")
        self._copy(name, self.target / name, own)
        shutil.rmtree(vanishing)

    def _copy(self, name: str, to: Path, own: random.Random) -> None:
        to.mkdir()
        for log in (self.source / name).iterdir():
            content = log.read_bytes()
            cuts = sorted(own.randrange(len(content)) for _ in range(own.randrange(4)))
            for first, last in zip([0, *cuts], [*cuts, len(content)], strict=True):
                with (to / log.name).open("ab") as file:
                    file.write(content[first:last])
                self._clock(to, own)
                if last < len(content):
                    self._wait(own)

    def _wait(self, own: random.Random, times: float = 1.0) -> None:
        self.ended.wait(own.uniform(0.0, self.pause) * own.choice((0.1, 1.0, 1.0, 10.0, times)))

    def _clock(self, folder: Path, own: random.Random) -> None:
        at = time.time() + own.choice(CLOCKS)
        for path in folder.iterdir():
            utime(path, (at, at))


def watched_and_killed(
    workspace: Path, logs: Path, kills: int, longest: float, rng: random.Random, feeding: Callable[[], bool]
) -> int:
    """Watch ``logs`` in a process of its own, which is killed at least ``kills`` times and until the feed ends.

    Args:
        longest: time from the first call of the watch until it is killed [s].

    Returns:
        The number of kills.
    """
    done = 0
    while done < kills or feeding():
        words = [sys.executable, "-c", WATCH, str(workspace), str(logs), str(QUIET)]
        with subprocess.Popen(words, stdout=subprocess.PIPE) as process:
            try:
                assert process.stdout is not None
                assert process.stdout.readline() == b"begins\n"
                process.wait(rng.uniform(0.0, longest))
                raise AssertionError(f"the watch ended by itself with status {process.returncode}")
            except subprocess.TimeoutExpired:
                done += 1
            finally:
                process.kill()
    return done
