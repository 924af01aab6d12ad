"""Serves a few pages to this computer alone: nothing but these, to nobody who does not ask for this computer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote, urlsplit

from sysid.errors import SysidError

HOST = "127.0.0.1"
#: Gives the bytes of a page; OSError or SysidError where it is gone, or has become a link.
Page = Callable[[], bytes]
#: No page runs a script, loads anything, or is shown inside another one.
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
#: A request that does not come is not waited for longer [s].
PATIENCE_S = 10.0


def page_server(pages: Mapping[str, Page], port: int = 0) -> ThreadingHTTPServer:
    """A server on the loopback interface, not yet running.

    Args:
        pages: path of the address (``/``, ``/cards/arm@1.html``) → what reads it, anew for every request.
        port: 0 takes a free one.

    Raises:
        OSError: the port is taken.
    """

    class Handler(BaseHTTPRequestHandler):
        timeout = PATIENCE_S

        def do_GET(self) -> None:
            # A page elsewhere may point its own name to this address; it then asks for that name.
            try:
                host = urlsplit(f"//{self.headers.get('Host', '')}").hostname
                page = pages.get(unquote(urlsplit(self.path).path))
            except ValueError:  # as `Host: [`
                self.send_error(400)
                return
            if host not in (HOST, "localhost"):
                self.send_error(403)
                return
            try:
                content = page() if page is not None else None
            except (OSError, SysidError):
                content = None
            if content is None:
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Content-Security-Policy", POLICY)
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            """Quiet: the terminal belongs to the person who started it."""

    return ThreadingHTTPServer((HOST, port), Handler)
