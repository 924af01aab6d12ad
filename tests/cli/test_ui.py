"""``sysid ui``: the pages on the disk, and served to this computer alone."""

from __future__ import annotations

import json
import socket
import struct
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
from command_line import run
from sample_workspace import sample_workspace

import sysid.site
from sysid.cli.ui import MAX_THREADS, PageServer, _pages, page_server
from sysid.errors import StorageError
from sysid.site import build_site


def test_the_pages_are_written_and_what_is_damaged_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sample_workspace(tmp_path / "ws")
    assert run("--workspace", tmp_path / "ws", "ui", "--json", tmp_path / "ui.json") == 0
    shown = capsys.readouterr().out
    assert "site/index.html  (12 pages made, 0 up to date)" in shown
    found = json.loads((tmp_path / "ui.json").read_text())
    assert found["index"] == str(tmp_path / "ws/site/index.html")
    assert "reports/autolog@1.html" in found["made"]
    assert run("--workspace", tmp_path / "ws", "ui") == 0
    assert "(0 pages made, 12 up to date)" in capsys.readouterr().out
    assert run("--workspace", tmp_path / "ws", "ui", "--out", tmp_path / "elsewhere") == 0
    assert (tmp_path / "elsewhere/index.html").is_file()


def test_an_empty_workspace_has_a_page_too(tmp_path: Path) -> None:
    assert run("--workspace", tmp_path, "ui") == 0
    assert "Nothing here yet" in (tmp_path / "site/index.html").read_text()


def test_a_port_that_is_taken_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with page_server({}) as server:
        assert run("--workspace", tmp_path, "ui", "--serve", "--port", server.server_address[1]) == 2
    assert "expected a free port; 0 takes one" in capsys.readouterr().err


def test_the_first_page_is_renewed_when_it_is_read(tmp_path: Path) -> None:
    place = sample_workspace(tmp_path)
    pages = _pages(place, build_site(place), None)
    before = pages["/"]()
    place.models.register("autolog", "plant", {"plant.json": b"[]"}, {})
    assert b"autolog@3" not in before
    assert b"autolog@3" in pages["/"]()
    assert b"autolog@3" in pages["/models/autolog@3.html"]()
    assert pages["/plotly.js"]().startswith(b"/**")


def test_the_page_is_served_to_this_computer_alone(tmp_path: Path) -> None:
    (tmp_path / "models.html").write_text("<p>models</p>")
    (tmp_path / "secret.html").write_text("no")
    pages = {"/": (tmp_path / "models.html").read_bytes, "/models/a@1.html": (tmp_path / "gone.html").read_bytes}
    with page_server(pages) as server:
        assert server.server_address[0] == "127.0.0.1"
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        address = f"http://127.0.0.1:{server.server_address[1]}"
        with urllib.request.urlopen(f"{address}/") as answer:
            assert answer.read() == b"<p>models</p>"
        for path, host, status in (
            ("/secret.html", "localhost", 404),
            ("/../secret.html", "localhost", 404),
            ("/models/a%401.html", "localhost", 404),
            ("/", "evil.example", 403),
        ):
            request = urllib.request.Request(address + path, headers={"Host": host})
            with pytest.raises(urllib.error.HTTPError) as refused:
                urllib.request.urlopen(request)
            assert refused.value.code == status
            refused.value.close()
        server.shutdown()
        thread.join()


@contextmanager
def serving(server: PageServer) -> Iterator[int]:
    with server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()


def asked(port: int) -> socket.socket:
    """A connection that has sent a request."""
    found = socket.create_connection(("127.0.0.1", port), timeout=60.0)
    found.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
    return found


def answer(connection: socket.socket) -> bytes:
    with connection, connection.makefile("rb") as file:
        return file.read()


def test_requests_at_the_same_time_are_all_answered_by_a_bounded_number_of_threads() -> None:
    content, working, most = b"x" * 300_000, 0, 0
    counted = threading.Lock()

    def page() -> bytes:
        nonlocal working, most
        with counted:
            working += 1
            most = max(most, working)
        threading.Event().wait(0.001)
        with counted:
            working -= 1
        return content

    with serving(page_server({"/": page})) as port, ThreadPoolExecutor(8) as readers:
        connections = [asked(port) for _ in range(200)]
        assert all(found.endswith(content) for found in readers.map(answer, connections))
    assert 1 < most <= MAX_THREADS


def test_a_client_that_goes_away_is_no_error(capfd: pytest.CaptureFixture[str]) -> None:
    begun, gone = threading.Semaphore(0), threading.Event()

    def page() -> bytes:
        begun.release()
        gone.wait(10.0)
        return b"x" * 3_000_000

    with serving(page_server({"/": page})) as port:
        connections = [asked(port) for _ in range(10)]
        connections.append(socket.create_connection(("127.0.0.1", port)))  # nothing asked
        for _ in range(10):
            assert begun.acquire(timeout=10.0)
        for connection in connections:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # closed by a reset
            connection.close()
        gone.set()
        assert answer(asked(port)).endswith(b"xxx")
    assert capfd.readouterr().err == ""


def test_the_first_page_is_built_once_for_all_that_wait_for_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = sample_workspace(tmp_path)
    builds = []
    waiting = threading.Barrier(8)

    def counting(*args: object) -> object:
        builds.append(args)
        return build_site(place)

    def read(_: int) -> bytes:
        waiting.wait()
        return pages["/"]()

    monkeypatch.setattr(sysid.site, "build_site", counting)
    pages = _pages(place, build_site(place), None)
    with ThreadPoolExecutor(8) as readers:
        assert len({*readers.map(read, range(8))}) == 1
    assert len(builds) < 8


def test_a_page_that_the_disk_refuses_says_so() -> None:
    def page() -> bytes:
        raise StorageError("site/index.html", "no <room>", remedy="Make room.")

    with serving(page_server({"/": page})) as port:
        found = answer(asked(port))
    assert found.startswith(b"HTTP/1.0 500 ")
    assert b"site/index.html: no &lt;room&gt;. Make room." in found
