"""Serves a few pages to this computer alone: nothing but these files, to nobody who does not ask for this computer."""

from __future__ import annotations

from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urlsplit

HOST = "127.0.0.1"


def page_server(pages: Mapping[str, Path], port: int = 0) -> ThreadingHTTPServer:
    """A server on the loopback interface, not yet running.

    Args:
        pages: path of the address (``/``, ``/cards/arm@1.html``) → file, read anew for every request.
        port: 0 takes a free one.

    Raises:
        OSError: the port is taken.
    """

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            # A page elsewhere may point its own name to this address; it then asks for that name.
            host = urlsplit(f"//{self.headers.get('Host', '')}").hostname
            file = pages.get(unquote(urlsplit(self.path).path))
            if host not in (HOST, "localhost"):
                self.send_error(403)
            elif file is None or not file.is_file():
                self.send_error(404)
            else:
                content = file.read_bytes()
                self.send_response(200)
                self.send_header("Content-Type", "text/html; charset=utf-8")
                self.send_header("Content-Length", str(len(content)))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(content)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            """Quiet: the terminal belongs to the person who started it."""

    return ThreadingHTTPServer((HOST, port), Handler)
