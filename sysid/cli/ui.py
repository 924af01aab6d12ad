"""``sysid ui``: the workspace as a site of linked pages, served on the loopback interface alone."""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

import click

from sysid.cli.output import FOLDER, Printer, json_option, progress_bar
from sysid.errors import SettingsError, StorageError, SysidError
from sysid.foreign import visible

if TYPE_CHECKING:
    from sysid.site import Built
    from sysid.workspace import Workspace


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


@click.command()
@click.option("--out", "folder", type=FOLDER, metavar="DIR", help="Default: site/.")
@click.option("--open", "show_it", is_flag=True, help="Open it in the browser.")
@click.option("--serve", is_flag=True, help="Serve it to this computer until Ctrl-C; reloading the first page renews it.")
@click.option("--port", type=click.IntRange(0, 65535), default=8642, show_default=True, help="For --serve; 0 takes a free one.")
@json_option
@click.pass_obj
def ui(location: str, folder: Path | None, show_it: bool, serve: bool, port: int, out: Printer) -> None:
    """Write the workspace as pages: datasets, reports, models, their lineage, and a comparison of any two.

    The pages are files that need neither a server nor a network. Only pages whose content has changed are made again.
    """
    from sysid.site import build_site
    from sysid.workspace import open_workspace

    workspace = open_workspace(location)
    with progress_bar("pages") as progress:
        built = build_site(workspace, folder, progress)
    out.line(f"{built.index}  ({len(built.made)} pages made, {len(built.kept)} up to date)")
    for path, reason in built.failed.items():
        click.echo(visible(f"not made: {path}: {reason}"), err=True)
    out.json({"schema": 1, "index": built.index, "made": built.made, "kept": built.kept, "failed": built.failed})
    if serve:
        _serve(_pages(workspace, built, folder), port, show_it)
    elif show_it:
        click.launch(built.index.resolve().as_uri())


def _pages(workspace: Workspace, built: Built, out: Path | None) -> dict[str, Page]:
    """URL path → page; reading the first one builds the site again, once for all requests that wait for it."""
    from sysid.root import Root
    from sysid.site import build_site

    root = Root(built.index.parent)
    one_at_a_time = threading.Lock()
    pages: dict[str, Page] = {}
    begun = 0.0

    def add(found: Built) -> None:
        for path in (*found.made, *found.kept):
            pages.setdefault(f"/{path}", partial(root.read, path))

    def first() -> bytes:
        nonlocal begun
        asked = time.monotonic()
        with one_at_a_time:
            if begun <= asked:
                begun = time.monotonic()
                add(build_site(workspace, out))
            return root.read("index.html")

    pages["/"] = pages["/index.html"] = first
    add(built)
    return pages


def _serve(pages: dict[str, Page], port: int, show_it: bool) -> None:
    try:
        server = page_server(pages, port)
    except OSError as error:
        raise SettingsError(f"--port {port}", f"cannot be used ({error.strerror})", "a free port; 0 takes one") from None
    with server:
        address = f"http://127.0.0.1:{server.server_address[1]}/"
        Printer().line(f"{address}  (Ctrl-C ends it)")
        if show_it:
            click.launch(address)
        server.serve_forever()
