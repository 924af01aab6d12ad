"""Inputs and results of training, and the training state of a member with its checkpoint: safetensors with a JSON header, one
file per member, replaced atomically.

The name of a checkpoint is a digest of all that decides the result: settings, layers, seed, rows, versions of the libraries.
Only equal training resumes from a file, and it then ends with the same bits as without an interruption.
"""

from __future__ import annotations

import json
import math
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sysid.config import Strict
from sysid.errors import SettingsError, StorageError, StoreError
from sysid.files import write_durably
from sysid.networks.batch import Floats
from sysid.networks.mlp import Mlp, Rectifier

Array = npt.NDArray[np.float64]


def require_positive(where: object, settings: object, *keys: str) -> None:
    """Raises SettingsError if one of the attributes ``keys`` is not a positive finite number."""
    for key in keys:
        value = getattr(settings, key)
        if not (math.isfinite(value) and value > 0):
            raise SettingsError(where, f"{key} = {value}", "a positive number")


@dataclass(frozen=True)
class TrainingSettings(Strict):
    """How a network is trained.

    Args:
        learning_rate: initial rate of Adam; a member may have its own.
        batch: rows per update; a member with fewer rows uses all of them.
        epochs: largest number of passes over the rows.
        patience: epochs without improvement on the validation rows after which a member is finished.
        check_every: epochs between two evaluations on the validation rows.
        schedule: ``constant``, or ``cosine`` down to a hundredth at the last update.
        threads: batches that are trained in parallel, one core each; 0 means every core. Results do not depend on it.
        device: ``auto`` is a GPU if there is one and it is faster. The last bits of a result depend on the device.
    """

    learning_rate: float
    batch: int = 64
    epochs: int = 500
    patience: int = 100
    check_every: int = 5
    schedule: Literal["constant", "cosine"] = "constant"
    threads: int = 0
    device: Literal["auto", "cpu", "cuda"] = "auto"

    def check(self, where: object) -> None:
        """Raises SettingsError for a value that cannot be used."""
        require_positive(where, self, "learning_rate", "batch", "epochs", "patience", "check_every")
        if self.threads < 0:
            raise SettingsError(where, f"threads = {self.threads}", "a number from 0 on (0: every core)")


@dataclass(frozen=True)
class EnsembleMember:
    """One network to train: rows in SI units.

    Args:
        name: determines, with the seed, the initial weights and the shuffle order; used in messages.
        inputs, outputs: fit rows, (n, d_in) and (n, d_out).
        validation_inputs, validation_outputs: early-stopping rows, (v, d_in) and (v, d_out).
        input_names, output_names: of the columns, for messages.
        hidden: units of the hidden layers; None: those of the call.
        learning_rate: None: that of the settings.
        rectifier: between its layers.
    """

    name: str
    inputs: Array
    outputs: Array
    validation_inputs: Array
    validation_outputs: Array
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    hidden: tuple[int, ...] | None = None
    learning_rate: float | None = None
    rectifier: Rectifier = "relu"


@dataclass(frozen=True)
class LearningCurve:
    """Learning curve of a member.

    Args:
        rows: numbers of fit and validation rows.
        epochs: passes over its rows until it was finished.
        best_epoch: the one whose weights are kept.
        validation_rmse: per output at ``best_epoch`` [SI].
        checked_epochs, fit_loss, validation_loss: (k,) each; losses are mean squared errors of normalised outputs, the former
            over the updates since the last check.
        seconds: wall time of the whole training.
    """

    rows: tuple[int, int]
    epochs: int
    best_epoch: int
    validation_rmse: tuple[float, ...]
    checked_epochs: tuple[int, ...]
    fit_loss: tuple[float, ...]
    validation_loss: tuple[float, ...]
    seconds: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """Without the wall time, so that equal runs give equal values."""
        return {key: value for key, value in asdict(self).items() if key != "seconds"}


@dataclass(frozen=True)
class TrainedMember:
    """The network with the weights of its best epoch, and its learning curve."""

    mlp: Mlp
    curve: LearningCurve


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
