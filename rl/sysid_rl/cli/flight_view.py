"""``sysid view FLIGHT.mcap``: a run of a machine in Rerun, while it is running or after it."""

from __future__ import annotations

from pathlib import Path

from sysid.cli.output import Printer, write_json
from sysid.errors import InputError


def show(log: Path, path: Path | None, json_file: str | None) -> None:
    """Show a flight log, or convert it to the ``.rrd`` file ``path``.

    Raises:
        InputError: there is no flight log.
    """
    from sysid.machine import load_machine
    from sysid_rl.run.live_view import show_flight

    out = Printer(json_file)
    if not log.is_file():
        raise InputError(str(log), "no such file", "a flight log of the runner")
    turns = show_flight(log, load_machine(log.parent.parent / "machine.toml"), path)
    out.line(f"{path or 'viewer'}  ({turns} cycles of {log.parent.name})")
    write_json(json_file, {"schema": 1, "file": path, "log": str(log), "turns": turns})
