"""An S3-compatible server (moto) on the loopback interface, as a process of its own."""

from __future__ import annotations

import contextlib
import re
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from installed_server import server_command

BUCKET = "machines"


@contextlib.contextmanager
def object_store(folder: Path, port: str = "0") -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Address and process of a server with an empty bucket; this process and its children use it for ``s3://``."""
    command = server_command("moto", "MOTO_SERVER", ".venv-object-store/bin/moto_server", "object-store")
    log = folder / "moto.log"
    with log.open("wb") as file:
        process = subprocess.Popen([command, "-H", "127.0.0.1", "-p", port], stdout=file, stderr=file)
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
