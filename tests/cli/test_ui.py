"""``sysid ui``: the pages on the disk, and served to this computer alone."""

from __future__ import annotations

import json
import threading
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from command_line import run
from sample_workspace import sample_workspace

from sysid.cli.loopback import page_server
from sysid.cli.ui import _pages
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
