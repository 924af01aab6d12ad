"""Schedulers that are trusted, those that are refused, and what answers in place of one."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import pytest
from click.testing import CliRunner
from tasks import doubled

from sysid.cli.app import app
from sysid.cli.verbs import names
from sysid.execution import TaskError, open_executor

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
from sysid.execution.cluster import ClusterExecutor, trusted_address

HERE = {
    "tcp://127.0.0.1:8786": "tcp://127.0.0.1:8786",
    "tcp://127.1.2.3:8786": "tcp://127.1.2.3:8786",
    "tcp://2130706433:8786": "tcp://127.0.0.1:8786",  # the same number, as some resolvers read it
    "127.0.0.1:8786": "tcp://127.0.0.1:8786",
    "[::1]:8786": "tcp://[::1]:8786",
    "tcp://[::1]:8786": "tcp://[::1]:8786",
    "tcp://[::ffff:127.0.0.1]:8786": "tcp://[::ffff:127.0.0.1]:8786",
    "ws://127.0.0.1:8786": "ws://127.0.0.1:8786",
}
#: Documentation addresses (RFC 5737, RFC 3849) and others that are not this computer.
BEYOND = (
    "tcp://192.0.2.1:8786",
    "192.0.2.1:8786",
    "ws://192.0.2.1:8786",
    "tcp://[2001:db8::1]:8786",
    "[2001:db8::1]:8786",
    "tcp://[::ffff:192.0.2.1]:8786",
    "tcp://0.0.0.0:8786",
)
NAMES = {"here": ["127.0.0.1", "::1"], "beyond": ["192.0.2.1"], "both": ["127.0.0.1", "192.0.2.1"]}
VERBS_WITH_CLUSTER = {"ingest", "fit", "gap", "fleet", "train"}


@pytest.fixture
def resolver(monkeypatch: pytest.MonkeyPatch) -> None:
    """A resolver that knows the names of ``NAMES`` and numbers."""

    def look_up(host: str, port: int, **_: object) -> list[tuple[object, ...]]:
        return [(0, 0, 0, "", (found, port)) for found in NAMES[host.partition(".")[0]]]

    monkeypatch.setattr(socket, "getaddrinfo", look_up)


@pytest.mark.parametrize(("address", "found"), HERE.items())
def test_this_computer_is_trusted(address: str, found: str) -> None:
    assert trusted_address(address) == found


@pytest.mark.parametrize("address", BEYOND)
def test_others_are_refused_unless_their_network_is_trusted(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(TaskError, match=r"not authenticated.*tls://HOST:PORT.*--trusted-network"):
        open_executor(address)
    monkeypatch.setenv("SYSID_CLUSTER", address)
    with pytest.raises(TaskError, match="not authenticated"):
        open_executor()
    assert open_executor(trusted_network=True) == ClusterExecutor(address, trusted_network=True)


@pytest.mark.usefixtures("resolver")
def test_a_name_is_connected_to_as_it_was_resolved() -> None:
    """A second look-up, for the connection, may have another answer."""
    assert trusted_address("tcp://here.lan:8786") == "tcp://127.0.0.1:8786"
    for name in ("beyond.lan", "both.lan"):
        with pytest.raises(TaskError, match="not authenticated"):
            trusted_address(f"tcp://{name}:8786")


@pytest.mark.parametrize("scheme", ["tls", "wss"])
def test_with_certificates_every_place_is_trusted(scheme: str) -> None:
    assert trusted_address(f"{scheme}://192.0.2.1:8786") == f"{scheme}://192.0.2.1:8786"


@pytest.mark.parametrize(
    "address",
    [
        "", "tcp://", "tcp://127.0.0.1", "tcp://127.0.0.1:x", "pipe://127.0.0.1:1", "tls://tcp://127.0.0.1:1", "::1:1",
        "ucx://192.0.2.1:1", "inproc://1/2/3",
    ],
)  # fmt: skip
@pytest.mark.parametrize("trusted_network", [False, True])
def test_what_is_no_address_is_refused(address: str, trusted_network: bool) -> None:
    with pytest.raises(TaskError, match="no address of a scheduler"):
        trusted_address(address, trusted_network)


@pytest.mark.parametrize("host", ["nowhere.invalid", "a" * 300])
def test_a_name_that_no_computer_has_is_refused(host: str) -> None:
    with pytest.raises(TaskError, match="no address of a scheduler"):
        trusted_address(f"tcp://{host}:8786")


@pytest.mark.parametrize("verb", names())
def test_every_verb_with_a_cluster_has_the_flag(verb: str) -> None:
    shown = CliRunner().invoke(app, [verb, "--help"]).output
    if verb == "fleet":
        shown = CliRunner().invoke(app, ["fleet", "gap", "--help"]).output
    assert ("--cluster" in shown) == ("--trusted-network" in shown) == (verb in VERBS_WITH_CLUSTER)


# -- what answers in place of a scheduler -----------------------------------------------------------------------------


def silent(peer: socket.socket) -> None:
    time.sleep(30.0)


def closes(peer: socket.socket) -> None:
    peer.close()


def sends(content: bytes) -> Callable[[socket.socket], None]:
    return lambda peer: peer.sendall(content)


def drips(peer: socket.socket) -> None:
    for _ in range(300):
        peer.sendall(b"\0")
        time.sleep(0.1)


def greets(peer: socket.socket) -> None:
    """The first message of a scheduler, and no other."""
    from distributed.protocol import dumps
    from distributed.protocol.utils import pack_frames_prelude

    frames = dumps({"compression": None, "python": (3, 11, 7), "pickle-protocol": 5})
    content = pack_frames_prelude(frames) + b"".join(map(bytes, frames))
    peer.sendall(struct.pack("<Q", len(content)) + content)
    time.sleep(30.0)


@contextmanager
def listener(answer: Callable[[socket.socket], None]) -> Iterator[str]:
    """Address at which every connection gets ``answer``."""
    peers = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve(peer: socket.socket) -> None:
            with suppress(OSError):  # the other side has closed it
                answer(peer)

        def accept() -> None:
            while True:
                try:
                    peer, _ = server.accept()
                except OSError:  # closed at the end of the test
                    return
                peers.append(peer)
                threading.Thread(target=serve, args=(peer,), daemon=True).start()

        threading.Thread(target=accept, daemon=True).start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
        for peer in peers:
            peer.close()


@pytest.mark.parametrize(
    "answer",
    [silent, closes, drips, greets, sends(b"\xff" * 4096), sends(b"HTTP/1.1 400 Bad Request\r\n\r\n"), sends(b"\0" * 4096),
     sends(struct.pack("<QQ", 2**40, 2**40)), sends(struct.pack("<QQ", 2**33, 1))],
    ids=["silent", "closes", "drips", "greets", "ones", "http", "zeros", "huge", "long"],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning", "ignore:.*was never awaited:RuntimeWarning")
def test_what_is_no_scheduler_is_an_error_in_time(
    answer: Callable[[socket.socket], None], capfd: pytest.CaptureFixture[str]
) -> None:
    with listener(answer) as address, pytest.raises(TaskError, match=r"does not answer as a Dask scheduler \(\w+\)"):
        ClusterExecutor(address, connect_s=1.0).run(doubled, [(1.0,)])
    assert "Traceback" not in capfd.readouterr().err
