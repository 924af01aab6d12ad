"""What :func:`sysid.confined.confined` does, in this process: the same results and errors, without limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from sysid.confined import Limits

T = TypeVar("T")


def read_here(
    work: Callable[[Callable[[float], None]], T],
    where: object,
    limits: Limits,
    kinds: Sequence[type],
    progress: Callable[[float], None] = lambda share: None,
) -> T:
    """The result of ``work``; errors of libraries are errors of the file."""
    from sysid.confined import _raised
    from sysid.errors import SysidError

    try:
        return work(progress)
    except (SysidError, OSError, ModuleNotFoundError):
        raise
    except Exception as error:
        raise _raised(["Exception", f"{type(error).__name__}: {error}"], where, limits) from None
