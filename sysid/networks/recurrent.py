"""Training of a small bounded recurrent network, of a plant's residual or an actuator network with history.

One LSTM layer, ``r = bound·tanh(w·h + w₀)``, evaluated by :mod:`sysid.networks.cell`. If its output is integrated (a speed into
a position), it is fitted to changes of the integral over several lags at once: short lags contain the detail, long lags have
the best signal-to-noise ratio.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.networks.cell import REACH
from sysid.networks.training import one_thread
from sysid.progress import Progress, silent

if TYPE_CHECKING:
    import torch

Array = npt.NDArray[np.float64]

#: Lags, in updates, over which changes of an integral are compared.
LAGS = (4, 16, 64)


@dataclass(frozen=True)
class RecordingWindow:
    """Inputs and targets of one recording, one row per interval.

    Args:
        inputs: (n, F).
        residual: target at each update, (n,): of an integral its value at the instant, else the mean until the next update. NaN
            where it was not measured.
        size: factor of the network's output, (n,).
    """

    inputs: Array
    residual: Array
    size: Array


@dataclass(frozen=True)
class RecurrentSettings:
    """Training settings.

    Args:
        units: of the LSTM.
        patience: evaluations on the select recordings without improvement, one per ``check_every`` epochs.
        piece, warm: updates per training sequence, and before it to initialise the state.
    """

    units: int = 16
    learning_rate: float = 0.02
    epochs: int = 300
    check_every: int = 10
    patience: int = 8
    decay: float = 1e-4
    piece: int = 160
    warm: int = 40


@dataclass(frozen=True)
class TrainedRecurrent:
    """A trained network.

    Args:
        weights: arrays by the names of :data:`sysid.networks.cell.TENSORS`.
        loss: on the select recordings, relative to the loss without the network.
    """

    weights: Mapping[str, Array]
    loss: float
    epochs: int


def train_recurrent(
    fit: Sequence[RecordingWindow], select: Sequence[RecordingWindow], bound: float, interval: float, integrates: bool,
    settings: RecurrentSettings | None = None, seed: int = 0, progress: Progress = silent,
) -> TrainedRecurrent:  # fmt: skip
    """Train on ``fit`` and return the weights with the lowest loss on ``select``.

    Args:
        bound: largest magnitude of the output; ``interval``: seconds between two updates.
        integrates: whether ``residual`` is the integral of the network's output.

    Raises:
        SettingsError: too few updates to train on.
    """
    import torch

    settings = settings or RecurrentSettings()
    joined = np.concatenate([part.inputs for part in fit]) if fit else np.empty((0, 1))
    if len(joined) < settings.warm or not select:
        raise SettingsError(
            "residual network", f"{len(joined)} updates to train on", f"at least {settings.warm}, and some to select"
        )
    mean, spread = joined.mean(axis=0), joined.std(axis=0)
    scale = np.where(spread > 1e-9 * np.maximum(np.abs(mean), 1e-12), 1.0 / np.maximum(spread, 1e-300), 0.0)
    with one_thread(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        cell = torch.nn.LSTM(joined.shape[1], settings.units, batch_first=True, dtype=torch.float64)
        head = torch.nn.Linear(settings.units, 1, dtype=torch.float64)
        with torch.no_grad():  # the initial output is nearly zero
            head.weight *= 0.1
            head.bias.zero_()
        parameters = [*cell.parameters(), *head.parameters()]
        adam = torch.optim.Adam(parameters, lr=settings.learning_rate, weight_decay=settings.decay)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, settings.epochs, 0.05 * settings.learning_rate)
        training, selection = (_sequences(parts, mean, scale, settings) for parts in (fit, select))
        units = _scales(fit, bound, interval, integrates)

        def loss(sequences: tuple[Any, Any, Any, Any]) -> torch.Tensor:
            x, residual, counts, size = sequences
            output = bound * size * torch.tanh(head(cell(x)[0])[..., 0])
            found: torch.Tensor = _loss(output, residual, counts, interval, integrates, units)
            return found

        with torch.no_grad():
            nothing = float(_loss(0.0 * selection[1], selection[1], selection[2], interval, integrates, units))
        best, kept, waited, epoch = np.inf, [p.detach().clone() for p in parameters], 0, 0
        for epoch in range(1, settings.epochs + 1):
            adam.zero_grad()
            total = loss(training)
            total.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(parameters, 1.0)
            adam.step()
            schedule.step()
            if epoch % settings.check_every:
                continue
            progress(epoch / settings.epochs, f"residual network, epoch {epoch}")
            with torch.no_grad():
                now = float(loss(selection))
            if now < best:
                best, kept, waited = now, [p.detach().clone() for p in parameters], 0
            else:
                waited += 1
                if waited >= settings.patience:
                    break
        W, U, b_in, b_state, w, w0 = (part.numpy().astype(np.float64) for part in kept)
    weights = {"mean": mean, "scale": scale, "W": W, "U": U, "b": b_in + b_state, "w": w[0], "w0": w0}
    return TrainedRecurrent(weights, best / nothing if nothing > 0.0 else np.inf, epoch)


def _loss(output: Any, residual: Any, counts: Any, interval: float, integrates: bool, units: Sequence[float]) -> Any:
    """Huber loss of the residual with the network, in units of the residual without it."""
    import torch

    terms = []
    if not integrates:
        terms.append(((residual - output) / units[0], counts))
    else:
        moved = torch.cumsum(output, dim=1) * interval  # after each update; the value at an update depends on those before it
        at = torch.nn.functional.pad(moved[:, :-1], (1, 0))
        rest = residual - at
        for lag, unit in zip(LAGS, units, strict=True):
            terms.append(((rest[:, lag:] - rest[:, :-lag]) / unit, counts[:, lag:] & counts[:, :-lag]))
    usable = [error[there & torch.isfinite(error)] for error, there in terms]
    return sum(torch.nn.functional.huber_loss(value, torch.zeros_like(value), delta=3.0) for value in usable) / len(usable)


def _scales(parts: Sequence[RecordingWindow], bound: float, interval: float, integrates: bool) -> tuple[float, ...]:
    """RMS of the residual without a network: of its changes over each lag, or of its values."""
    if not integrates:
        return (max(_rms(np.concatenate([p.residual for p in parts])), 1e-6 * bound),)
    lagged = (np.concatenate([p.residual[lag:] - p.residual[:-lag] for p in parts]) for lag in LAGS)
    return tuple(max(_rms(values), 1e-6 * bound * interval) for values in lagged)


def interval_means(values: Array, stride: int) -> Array:
    """Means over intervals of ``stride`` samples without NaN, (n / stride,); NaN where nothing was measured."""
    blocks = values.reshape(-1, stride)
    measured = np.isfinite(blocks)
    total = np.where(measured, blocks, 0.0).sum(axis=1) / np.maximum(measured.sum(axis=1), 1)
    return np.where(measured.any(axis=1), total, np.nan)


def _rms(values: Array) -> float:
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if len(there) else 0.0


def _sequences(
    parts: Sequence[RecordingWindow], mean: Array, scale: Array, settings: RecurrentSettings
) -> tuple[Any, Any, Any, Any]:
    """Sequences of equal length (k, warm + piece, …): inputs, residual, whether an update counts in the loss, size."""
    import torch

    inputs, residual, counts, size, whole = [], [], [], [], settings.warm + settings.piece
    for part in parts:
        x = np.clip((part.inputs - mean) * scale, -REACH, REACH)
        for first in range(0, max(len(x) - LAGS[-1], 1), settings.piece):
            begin = max(first - settings.warm, 0)
            here = slice(begin, min(begin + whole, len(x)))
            missing = whole - (here.stop - here.start)
            inputs.append(np.pad(x[here], ((0, missing), (0, 0))))
            residual.append(np.pad(part.residual[here], (0, missing), constant_values=np.nan))
            size.append(np.pad(part.size[here], (0, missing)))
            counts.append(np.arange(begin, begin + whole) >= (first if first else 0))
    made = [torch.from_numpy(np.array(values)) for values in (inputs, residual, counts, size)]
    return made[0], made[1], made[2], made[3]
