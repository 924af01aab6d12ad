"""Which schedulers are trusted: those behind an authenticated connection, and those of this computer.

Dask sends pickles in both directions: whoever answers at the address of a scheduler runs programs on the computer that calls.
"""

from __future__ import annotations

import ipaddress
import socket

from sysid.execution.executor import TaskError

#: Schemes of connections in which both sides prove who they are, by certificates.
AUTHENTICATED = ("tls", "wss")
_EXPECTED = "tls://HOST:PORT, or tcp://HOST:PORT of this computer"


def trusted_address(address: str, trusted_network: bool = False) -> str:
    """The address to connect to: a name that must mean this computer is replaced by what it was resolved to.

    Args:
        address: as Dask takes it, with or without a scheme.
        trusted_network: an address beyond this computer needs no authentication.

    Raises:
        TaskError: no address, or one whose connection is not authenticated.
    """
    from distributed.comm.addressing import get_address_host_port, parse_address, unparse_address, unparse_host_port

    where = f"cluster {address}"
    try:
        scheme, _ = parse_address(address)
        host, port = get_address_host_port(address)
        if trusted_network or scheme in AUTHENTICATED:
            return address
        found = sorted({info[4][0] for info in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)}, key=_version)
    except (ValueError, OSError) as error:
        raise TaskError(where, f"no address of a scheduler: {error}", _EXPECTED) from None
    if not all(map(_is_loopback, found)):
        raise TaskError(
            where, f"{scheme}:// is not authenticated, and whoever answers there runs programs on this computer", _EXPECTED,
            "Set up TLS (docs/guide/cluster.md), or add --trusted-network if you trust every computer of the network.",
        )  # fmt: skip
    return str(unparse_address(scheme, unparse_host_port(str(found[0]), port)))


def _version(host: str | int) -> int:
    return ipaddress.ip_address(host).version


def _is_loopback(host: str | int) -> bool:
    found = ipaddress.ip_address(host)
    mapped = found.ipv4_mapped if isinstance(found, ipaddress.IPv6Address) else None
    return (mapped or found).is_loopback
