"""TorchScript files. PyTorch deprecates the format, which Isaac Lab loads: its warnings are not those of a user's mistake."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

_jit: Any = torch.jit


@contextmanager
def deprecation_known() -> Iterator[None]:
    """Without the warning that TorchScript is deprecated."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"`torch\.jit\..*", DeprecationWarning)
        yield


def scripted(module: torch.nn.Module) -> Any:
    """A module as a script."""
    with deprecation_known():
        return _jit.script(module.eval())


def save_script(module: Any, path: Path) -> None:
    """Write a script to a file."""
    with deprecation_known():
        _jit.save(module, str(path))


def load_script(path: Path) -> Any:
    """The script of a file, on the CPU."""
    with deprecation_known():
        return _jit.load(str(path), map_location="cpu")
