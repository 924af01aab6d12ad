"""An S3-compatible server (moto) on the loopback interface, as a process of its own."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

#: The command of the server: this variable, else that of `make object-store`, else one on the path.
VARIABLE = "MOTO_SERVER"
INSTALLED = Path(__file__).parents[2] / ".venv-object-store/bin/moto_server"
BUCKET = "machines"


def command() -> str:
    """The command of the server.

    Raises:
        Skipped: it is not installed.
    """
    found = os.environ.get(VARIABLE) or (str(INSTALLED) if INSTALLED.exists() else None)
    if found is None:
        pytest.skip(f"moto is not installed: `make object-store` installs it, or name its moto_server in {VARIABLE}")
    return found


@contextlib.contextmanager
def object_store(folder: Path, port: str = "0") -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Address and process of a server with an empty bucket; this process and its children use it for ``s3://``."""
    log = folder / "moto.log"
    with log.open("wb") as file:
        process = subprocess.Popen([command(), "-H", "127.0.0.1", "-p", port], stdout=file, stderr=file)
    try:
        address = _address(log, process)
        urllib.request.urlopen(urllib.request.Request(f"{address}/{BUCKET}", method="PUT"), timeout=30.0).close()
        with pytest.MonkeyPatch.context() as patch:
            for name, value in settings(address).items():
                patch.setenv(name, value)
            yield address, process
    finally:
        process.kill()
        process.wait()


def settings(address: str) -> dict[str, str]:
    """The environment of a client."""
    return {
        "AWS_ENDPOINT_URL": address,
        "AWS_ALLOW_HTTP": "true",
        "AWS_REGION": "us-east-1",
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing",
        "AWS_EC2_METADATA_DISABLED": "true",
    }


def _address(log: Path, process: subprocess.Popen[bytes]) -> str:
    limit = time.monotonic() + 90.0
    while time.monotonic() < limit and process.poll() is None:
        found = re.search(r"Running on (http://127\.0\.0\.1:\d+)", log.read_text("utf-8"))
        if found:
            return found.group(1)
        time.sleep(0.1)
    raise AssertionError(log.read_text("utf-8"))
