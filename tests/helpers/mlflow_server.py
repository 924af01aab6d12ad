"""A full MLflow server on the loopback interface, as a process of its own with an sqlite database behind it."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

from installed_server import server_command

#: Time until the server has to answer [s].
START_S = 180.0


@contextlib.contextmanager
def mlflow_server(folder: Path) -> Iterator[str]:
    """Address of a server whose database and artifacts are in ``folder``."""
    command = server_command("MLflow", "MLFLOW_SERVER", ".venv-mlflow/bin/mlflow", "model-server")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    database, files = f"sqlite:///{folder / 'server.db'}", folder / "artifacts"
    options = ["--backend-store-uri", database, "--artifacts-destination", str(files), "--workers", "2"]
    # The settings of this environment are not those of the server's own.
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "MLFLOW", "VIRTUAL_ENV"))}
    quiet = {"MLFLOW_DISABLE_TELEMETRY": "true", "DO_NOT_TRACK": "true", "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
    with (folder / "server.log").open("wb") as log:
        process = subprocess.Popen(
            [command, "server", *options, "--host", "127.0.0.1", "--port", str(port)],
            stdout=log,
            stderr=log,
            env={**kept, **quiet},
            start_new_session=True,
        )
    try:
        address = f"http://127.0.0.1:{port}"
        _wait(address, process, folder / "server.log")
        yield address
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, 9)
        process.wait()


def _wait(address: str, process: subprocess.Popen[bytes], log: Path) -> None:
    """Until the server answers."""
    end = time.monotonic() + START_S
    while time.monotonic() < end and process.poll() is None:
        try:
            urllib.request.urlopen(f"{address}/health", timeout=5.0).close()
        except (urllib.error.URLError, OSError):
            time.sleep(0.5)
        else:
            return
    raise RuntimeError(f"the server does not answer: {log.read_text('utf-8', 'replace')[-2000:]}")
