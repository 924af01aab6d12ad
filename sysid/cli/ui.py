"""``sysid ui``: the workspace as a site of linked pages."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING

import click

from sysid.cli.output import Printer, json_option, progress_bar, write_json
from sysid.errors import SettingsError
from sysid.foreign import visible

if TYPE_CHECKING:
    from sysid.cli.loopback import Page
    from sysid.site import Built
    from sysid.workspace import Workspace


@click.command()
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), default=None, metavar="DIR", help="Default: site/.")
@click.option("--open", "show_it", is_flag=True, help="Open it in the browser.")
@click.option("--serve", is_flag=True, help="Serve it to this computer until Ctrl-C; reloading the first page renews it.")
@click.option("--port", type=click.IntRange(0, 65535), default=8642, show_default=True, help="For --serve; 0 takes a free one.")
@json_option
@click.pass_obj
def ui(location: str, out: Path | None, show_it: bool, serve: bool, port: int, json_file: str | None) -> None:
    """Write the workspace as pages: datasets, reports, models, their lineage, and a comparison of any two.

    The pages are files that need neither a server nor a network. Only pages whose content has changed are made again.
    """
    from sysid.site import build_site
    from sysid.workspace import open_workspace

    workspace = open_workspace(location)
    with progress_bar("pages") as progress:
        built = build_site(workspace, out, progress)
    printer = Printer(json_file)
    printer.line(f"{built.index}  ({len(built.made)} pages made, {len(built.kept)} up to date)")
    for path, reason in built.failed.items():
        click.echo(visible(f"not made: {path}: {reason}"), err=True)
    write_json(json_file, {"schema": 1, "index": built.index, "made": built.made, "kept": built.kept, "failed": built.failed})
    if serve:
        _serve(_pages(workspace, built, out), port, show_it)
    elif show_it:
        click.launch(built.index.resolve().as_uri())


def _pages(workspace: Workspace, built: Built, out: Path | None) -> dict[str, Page]:
    """URL path → page; reading the first one builds the site again, once for all requests that wait for it."""
    import time
    from functools import partial

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
    from sysid.cli.loopback import page_server

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
