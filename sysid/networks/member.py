"""Inputs and results of training."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sysid.config import Strict
from sysid.errors import SettingsError
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
