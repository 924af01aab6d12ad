"""Libraries take no settings from the current folder, which may be a stranger's.

- Numba reads ``.numba_config.yaml`` there when it is imported and before it compiles. The file may name a folder of compiled
  code, which are pickles. Settings of Numba are environment variables, ``NUMBA_…``.
- Matplotlib, where it is installed, reads ``matplotlibrc`` there when it is imported. This package draws nothing with it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType, ModuleType
from typing import Any

_CONFIG = "numba.core.config"
_FILE = ".numba_config.yaml"


class _ConfigFinder:
    """Finds the module of Numba's settings as Python does, and lets :class:`_ConfigLoader` load it."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name != _CONFIG:
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _ConfigLoader(spec.loader.name, spec.loader.path)
        return spec


class _ConfigLoader(SourceFileLoader):
    """Loads the module with the name of a file that never is one in place of the file in the current folder."""

    def get_code(self, fullname: str) -> CodeType | None:
        code = super().get_code(fullname)
        return code and code.replace(co_consts=tuple(os.devnull if value == _FILE else value for value in code.co_consts))


def ignore_numba_file() -> None:
    """From now on Numba does not read the file; what it has read before is undone."""
    config: Any = sys.modules.get(_CONFIG)
    if config is None:
        sys.meta_path.insert(0, _ConfigFinder)
    else:
        config._config_fname = os.devnull
        config.reload_config()


@contextmanager
def without_matplotlib() -> Iterator[None]:
    """Imports within find no Matplotlib, unless it has been imported before."""
    hidden = sys.modules.setdefault("matplotlib", None) is None  # type: ignore[arg-type]
    try:
        yield
    finally:
        if hidden:
            sys.modules.pop("matplotlib", None)
