"""Functions and constants of `sysid.gap` replaced for a while, in every module that has imported them."""

from __future__ import annotations

import contextlib
import importlib
import pkgutil
import sys
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any

import sysid.gap


@contextlib.contextmanager
def replaced(changes: Mapping[str, Any]) -> Iterator[None]:
    """Replace names by others.

    Args:
        changes: ``module.name`` or ``module.Class.name`` below `sysid.gap` → what stands in its place.

    Raises:
        AttributeError: there is no such name, so that a trial cannot test nothing.
    """
    undo: list[tuple[Any, str, Any]] = []
    try:
        for where, new in changes.items():
            name = where.rpartition(".")[2]
            for module in holders(where):
                undo.append((module, name, vars(module)[name]))
                setattr(module, name, new)
        yield
    finally:
        for module, name, old in reversed(undo):
            setattr(module, name, old)


def holders(where: str) -> list[Any]:
    """The modules, or the class, in which ``module.name`` or ``module.Class.name`` stands.

    Raises:
        AttributeError: there is no such name.
    """
    owner, name = _owner(where)
    old = vars(owner)[name] if name in vars(owner) else getattr(owner, name)
    return [owner] if isinstance(owner, type) else [m for m in _modules() if _is(vars(m).get(name), old)]


def load_all() -> list[ModuleType]:
    """Import every module of `sysid.gap`: one that is imported later would not see a replacement."""
    loaded = []
    for found in pkgutil.walk_packages(sysid.gap.__path__, "sysid.gap."):
        with contextlib.suppress(ImportError):  # of an extra that is not installed
            loaded.append(importlib.import_module(found.name))
    return loaded


def _owner(where: str) -> tuple[Any, str]:
    parts = where.split(".")
    try:
        return importlib.import_module(".".join(("sysid.gap", *parts[:-1]))), parts[-1]
    except ModuleNotFoundError:
        module = importlib.import_module(".".join(("sysid.gap", *parts[:-2])))
        return getattr(module, parts[-2]), parts[-1]


def _modules() -> list[Any]:
    return [module for name, module in list(sys.modules.items()) if name.startswith("sysid.gap")]


def _is(found: Any, old: Any) -> bool:
    return found is old or (isinstance(old, int | float) and type(found) is type(old) and found == old)
