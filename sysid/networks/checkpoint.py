"""Training state of a member and its checkpoint: safetensors with a JSON header, one file per member, replaced atomically.

The file name is a digest of all that decides the result: settings, layers, seed, rows, versions of the libraries. Only equal
training resumes from a file, and it then ends with the same bits as without an interruption.
"""

from __future__ import annotations

import json
import math
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import StorageError, StoreError
from sysid.files import write_durably
from sysid.networks.batch import Floats

#: Format of the files, part of their names.
FORMAT = 1
#: Attempts to write a checkpoint while other trainings remove their empty folder.
TRIES = 5
REMEDY = "Make room; training goes on from the last checkpoint that was written."
_ARRAYS = ("row", "first", "second", "best")
_NUMBERS = ("step", "loss", "seen", "best_epoch", "best_loss", "finished", "epochs", "fit", "validation")


@dataclass
class State:
    """One member between two updates.

    Args:
        row, first, second: parameters and the two moments of Adam, (P,).
        best: parameters at the best check; empty before the first.
        step: number of updates.
        loss, seen: sum and number of the losses of the updates since the last check.
        epochs, fit, validation: epoch and losses of the checks.
        finished: whether training has ended.
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
    """Checkpoint files of a training run; they are removed on success and stay after an interruption.

    Args:
        folder: made when it is missing.
        every: seconds between two checkpoints.
    """

    folder: Path
    every: float = 30.0

    def save(self, name: str, state: State) -> None:
        """Write a checkpoint.

        Raises:
            StorageError: the disk is full or fails; the previous file stays whole.
        """
        from safetensors.numpy import save

        header = json.dumps({key: getattr(state, key) for key in _NUMBERS})
        content = save({key: getattr(state, key) for key in _ARRAYS}, {"format": str(FORMAT), "state": header})
        for tries_left in range(TRIES - 1, -1, -1):
            try:
                write_durably(self.path(name), content, "checkpoint", REMEDY)
                return
            except StorageError as error:  # another training removes the folder when it is empty
                if not tries_left or not isinstance(error.__cause__, FileNotFoundError):
                    raise

    def load(self, name: str, size: int) -> State | None:
        """The checkpoint ``name``, or None.

        Raises:
            StoreError: a file that is not a checkpoint of ``size`` parameters.
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
        """Remove the files of one member, and the folder when it is empty."""
        for pattern in (f"{name}.safetensors", f".{name}.safetensors.*"):  # also temporary files of a crash
            for path in self.folder.glob(pattern):
                path.unlink(missing_ok=True)
        with suppress(OSError):  # not empty, or removed by another training
            self.folder.rmdir()

    def path(self, name: str) -> Path:
        return self.folder / f"{name}.safetensors"
