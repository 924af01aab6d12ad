"""The page from one laptop to a cluster is followed word by word, on the loopback interface."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from page_walk import prepare, walk

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
from scaling import loopback

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/guide/cluster.md"
#: Ports that the page names.
PORTS = (8786, 8790)


def is_free(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) != 0


@contextlib.contextmanager
def processes_ended(folder: Path) -> Iterator[None]:
    """Kill what the page started, also where a command of it failed."""
    try:
        yield
    finally:
        for file in folder.glob("*.pid"):
            number = int(file.read_text())
            place = Path(f"/proc/{number}/cmdline")
            if place.exists() and b"dask" in place.read_bytes():  # and no other process that has the number now
                with contextlib.suppress(ProcessLookupError):
                    os.kill(number, signal.SIGKILL)


def followed(folder: Path, slow: bool) -> int:
    """Number of blocks of commands that ran."""
    busy = [port for port in PORTS if not is_free(port)]
    if busy:
        pytest.skip(f"port {busy[0]} is in use on this machine")
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    prepare(PAGE, folder)
    with processes_ended(folder):
        return sum(step.block.kind == "sh" for step in walk(PAGE, folder, slow=slow))


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_page_works_word_by_word(tmp_path: Path) -> None:
    assert followed(tmp_path, slow=False) >= 6


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_the_page_works_word_by_word_with_its_long_commands(tmp_path: Path) -> None:
    assert followed(tmp_path, slow=True) >= 8
    assert (tmp_path / "fleet.json").exists()


def listening(parent: int) -> set[str]:
    """Addresses on which the descendants of a process listen, in IPv4 and IPv6 (there as hexadecimal digits)."""
    family = [parent]
    for number in family:
        for file in Path(f"/proc/{number}/task").glob("*/children"):
            family += map(int, file.read_text().split())
    links = (link for number in family for link in Path(f"/proc/{number}/fd").iterdir())
    sockets = set()
    for link in links:
        with contextlib.suppress(OSError):
            sockets.add(os.readlink(link).removeprefix("socket:[").removesuffix("]"))
    found = set()
    for protocol in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{protocol}").read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == "0A" and words[9] in sockets:
                raw = words[1].partition(":")[0]
                found.add(socket.inet_ntoa(bytes.fromhex(raw)[::-1]) if protocol == "tcp" else raw)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "interrupts"),
    [("SIGINT", "default_int_handler"), ("SIGTERM", "default_int_handler"), ("SIGTERM", "SIG_IGN")],
    ids=["ctrl-c", "terminated", "terminated as a background job"],
)
def test_make_cluster_runs_until_it_is_ended(name: str, interrupts: str, tmp_path: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    code = f"import runpy, signal; signal.signal(signal.SIGINT, signal.{interrupts}); "
    code += f"runpy.run_path({loopback.__file__!r}, run_name='__main__')"
    command = [sys.executable, "-c", code, "1", str(port)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    log = tmp_path / "log"
    with log.open("wb") as file:
        process = subprocess.Popen(command, env=environment, cwd=tmp_path, stdout=file, stderr=file)
    try:
        limit = time.monotonic() + 120.0
        while b"Register worker" not in log.read_bytes():
            assert process.poll() is None, log.read_text("utf-8")
            assert time.monotonic() < limit, log.read_text("utf-8")
            time.sleep(0.2)
        if sys.platform == "linux":
            assert listening(process.pid) == {"127.0.0.1"}
        process.send_signal(getattr(signal, name))
        assert process.wait(60.0) == 0
    finally:
        process.kill()
        process.wait()
    assert f"tcp://127.0.0.1:{port}: 1 workers".encode() in log.read_bytes()
    assert is_free(port)
