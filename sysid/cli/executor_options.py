"""Options of the commands whose tasks run side by side."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

workers_option = click.option(
    "--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes on this machine."
)


def cluster_option(describes: str = "Address of a Dask scheduler, as tcp://HOST:PORT.") -> Callable[[Any], Any]:
    """``--cluster`` and ``--trusted-network``; ``describes``: help of the first."""
    address = click.option("--cluster", envvar="SYSID_CLUSTER", default=None, metavar="ADDRESS", help=describes)
    trusted = click.option(
        "--trusted-network",
        envvar="SYSID_TRUSTED_NETWORK",
        is_flag=True,
        help="Accept a scheduler without TLS on another computer: any computer of the network can then run programs here.",
    )
    return lambda command: address(trusted(command))
