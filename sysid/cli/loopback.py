"""HTTP server for a fixed set of pages on the loopback interface; requests for other host names are refused."""

from __future__ import annotations

import socket
import sys
import threading
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import unquote, urlsplit

from sysid.errors import StorageError, SysidError

HOST = "127.0.0.1"
#: Reads a page; raises OSError or SysidError if it is missing or a link, StorageError if the disk fails.
Page = Callable[[], bytes]
#: No external content, no embedding. Pages restrict their scripts further by a policy of their own.
POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
#: Longest wait for a client to send or to take more [s].
TIMEOUT_S = 10.0
#: Requests that are answered at a time, and connections that wait in the system for their turn.
MAX_THREADS, MAX_WAITING = 32, 1024


class PageServer(ThreadingHTTPServer):
    """Answers at most :data:`MAX_THREADS` requests at a time; others wait. A client that disconnects is not an error."""

    request_queue_size = MAX_WAITING

    def __init__(self, port: int, handler: type[BaseHTTPRequestHandler]) -> None:
        self._free = threading.BoundedSemaphore(MAX_THREADS)
        super().__init__((HOST, port), handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        self._free.acquire()
        try:
            super().process_request(request, client_address)
        except BaseException:  # no thread was started
            self._free.release()
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: socket.socket | tuple[bytes, socket.socket], client_address: Any) -> None:
        if not isinstance(sys.exc_info()[1], ConnectionError | TimeoutError):
            super().handle_error(request, client_address)


def page_server(pages: Mapping[str, Page], port: int = 0) -> PageServer:
    """A server on the loopback interface, not yet running.

    Args:
        pages: URL path (``/``, ``/cards/arm@1.html``) → function that reads the page for each request.
        port: 0 selects a free one.

    Raises:
        OSError: the port is taken.
    """

    class Handler(BaseHTTPRequestHandler):
        timeout = TIMEOUT_S

        def do_GET(self) -> None:
            # Against DNS rebinding: a page elsewhere may resolve its own name to this address.
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
            except StorageError as error:
                self.send_error(500, explain=str(error))
                return
            except (OSError, SysidError):
                content = None
            if content is None:
                self.send_error(404)
                return
            self.send_response(200)
            script = urlsplit(self.path).path.endswith(".js")
            self.send_header("Content-Type", f"text/{'javascript' if script else 'html'}; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Content-Security-Policy", POLICY)
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            """Log nothing."""

    return PageServer(port, Handler)
