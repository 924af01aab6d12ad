"""A Dask cluster on the loopback interface: ``python pipelines/scaling/loopback.py [WORKERS] [PORT]``, until Ctrl-C.

For trying ``--cluster`` on one machine. Nothing listens on another interface.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from typing import IO

from sysid.children import child_environment, python_command

HOST, PORT = "127.0.0.1", 8786
#: Time for a process to end after SIGTERM [s].
END_S = 10.0


def commands(workers: int, port: int) -> list[list[str]]:
    """The commands of a scheduler and of ``workers`` workers with one thread each."""
    # Without an address of its own, the HTTP server listens on every interface, also with --no-dashboard.
    shared = ["--host", HOST, "--dashboard-address", f"{HOST}:0"]
    address = f"tcp://{HOST}:{port}"
    scheduler = python_command("-m", "distributed.cli.dask_scheduler", "--port", str(port), *shared)
    worker = python_command("-m", "distributed.cli.dask_worker", address, "--nworkers", "1", "--nthreads", "1", *shared)
    return [scheduler, *[worker] * workers]


@contextlib.contextmanager
def running(work: Sequence[Sequence[str]], log: IO[bytes] | None = None) -> Iterator[list[subprocess.Popen[bytes]]]:
    """The commands as processes, which end with the block; numerical libraries use one thread in each.

    Args:
        log: for what they print; by default it is shown.
    """
    environment = {"OMP_NUM_THREADS": "1", **child_environment()}
    # In sessions of their own, so that Ctrl-C ends this process alone, which then ends them in order.
    started = [subprocess.Popen(list(words), env=environment, stdout=log, stderr=log, start_new_session=True) for words in work]
    try:
        yield started
    finally:
        for process in reversed(started):
            process.send_signal(signal.SIGTERM)
        for process in started:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_S)
            process.kill()
            process.wait()


def main(workers: int = 2, port: int = PORT) -> int:
    """Run the cluster until a signal; returns the exit status."""
    with contextlib.suppress(KeyboardInterrupt):
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # raises KeyboardInterrupt, also where SIGINT is ignored
        with running(commands(workers, port)) as processes:
            sys.stdout.write(f"tcp://{HOST}:{port}: {workers} workers. Ctrl-C ends them.\n")
            sys.stdout.flush()
            os.waitpid(processes[0].pid, 0)
            return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*map(int, sys.argv[1:3])))
