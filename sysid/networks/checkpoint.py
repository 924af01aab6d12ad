"""Where a member's training stands, and files that keep it: safetensors with a JSON header, one a member, replaced atomically.

A file is named after all that decides the result: settings, layers, seed, rows, versions of the libraries. Training that
differs in any of it does not find the file; training that does not goes on to the bits it would have reached without a break.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import StoreError
from sysid.files import write_durably
from sysid.networks.batch import Floats

#: Of the files; another one is another name.
FORMAT = 1
REMEDY = "Make room; training goes on from the last checkpoint that was written."
_ARRAYS = ("row", "first", "second", "best")
_NUMBERS = ("step", "loss", "seen", "best_epoch", "best_loss", "finished", "epochs", "fit", "validation")


@dataclass
class State:
    """One member between two updates.

    Args:
        row, first, second: parameters and the two moments of Adam, (P,).
        best: parameters of the best check so far; empty before the first.
        step: updates made.
        loss, seen: sum of the losses of the updates since the last check, and how many they are.
        epochs, fit, validation: of the checks so far.
        finished: nothing is left to do.
    """

    row: Floats
    first: Floats
    second: Floats
    best: Floats = field(default_factory=lambda: np.empty(0, dtype=np.float32))
    step: int = 0
    loss: float = 0.0
    seen: int = 0
    best_epoch: int = 0
    best_loss: float = math.inf
    finished: bool = False
    epochs: list[int] = field(default_factory=list)
    fit: list[float] = field(default_factory=list)
    validation: list[float] = field(default_factory=list)

    @staticmethod
    def at_start(row: Floats) -> State:
        return State(row, np.zeros_like(row), np.zeros_like(row))


@dataclass(frozen=True)
class Checkpoints:
    """Files of training that is under way; they go when it is done, and stay when it is interrupted.

    Args:
        folder: where; made when it is missing.
        every: seconds between two looks at the clock that write.
    """

    folder: Path
    every: float = 30.0

    def save(self, name: str, state: State) -> None:
        """Raises StorageError where the disk is full or fails; the file that was there before stays whole."""
        from safetensors.numpy import save

        header = json.dumps({key: getattr(state, key) for key in _NUMBERS})
        content = save({key: getattr(state, key) for key in _ARRAYS}, {"format": str(FORMAT), "state": header})
        write_durably(self.path(name), content, "checkpoint", REMEDY)

    def load(self, name: str, size: int) -> State | None:
        """What was saved under ``name``, None where nothing was.

        Raises:
            StoreError: a file that is no checkpoint of ``size`` parameters.
        """
        from safetensors import SafetensorError, safe_open

        path = self.path(name)
        if not path.exists():
            return None
        try:
            with safe_open(path, framework="numpy") as file:
                numbers: dict[str, Any] = json.loads(file.metadata()["state"])
                arrays = {key: file.get_tensor(key) for key in _ARRAYS}
            state = State(**{key: arrays[key] for key in _ARRAYS}, **{key: numbers[key] for key in _NUMBERS})
        except (SafetensorError, KeyError, TypeError, ValueError) as error:
            raise StoreError(f"checkpoint {path}", f"not readable ({error})", "what training wrote", "Delete it.") from None
        if any(len(values) not in (size, 0) for values in arrays.values()) or not len(state.row) == len(state.first) == size:
            found = f"{[len(values) for values in arrays.values()]} numbers"
            raise StoreError(f"checkpoint {path}", found, f"{size} parameters", "Delete it.")
        return state

    def remove(self, name: str) -> None:
        """Forget one member; the folder goes with the last of its files."""
        for pattern in (f"{name}.safetensors", f".{name}.safetensors.*"):  # and what a crash left of it
            for path in self.folder.glob(pattern):
                path.unlink(missing_ok=True)
        if self.folder.is_dir() and not any(self.folder.iterdir()):
            self.folder.rmdir()

    def path(self, name: str) -> Path:
        return self.folder / f"{name}.safetensors"
