"""Trains the small recurrent network that carries what no effect explains: sequences in, weights out.

One layer of long short-term memory behind a bound, ``r = bound·tanh(w·h + w₀)``, run by :mod:`sysid.networks.cell`. Where
what it adds is integrated (a speed into a position), it is fitted to changes of the integral over several lengths of time
at once: short ones hold most of the detail, long ones are least disturbed by the sensor's noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.networks.cell import REACH
from sysid.progress import Progress, silent

if TYPE_CHECKING:
    import torch

Array = npt.NDArray[np.float64]

#: Looks over which changes of an integral are compared.
LAGS = (4, 16, 64)


@dataclass(frozen=True)
class RecordingWindow:
    """One recording as the network sees it, a row every interval.

    Args:
        inputs: (n, F).
        left: what is left over at each look, (n,); of an integral at the instant, else the mean until the next look. NaN where
            it was not measured.
        size: what the network says is multiplied by this, (n,).
    """

    inputs: Array
    left: Array
    size: Array


@dataclass(frozen=True)
class RecurrentSettings:
    """How it is trained.

    Args:
        units: of its memory.
        patience: checks on the recordings to select without improvement, one each ``check_every`` epochs.
        piece, warm: looks in a piece of a sequence that is trained at once, and before it to warm up.
    """

    units: int = 16
    learning_rate: float = 0.02
    epochs: int = 300
    check_every: int = 10
    patience: int = 8
    decay: float = 1e-4
    threads: int = 1
    piece: int = 160
    warm: int = 40


@dataclass(frozen=True)
class Recurrent:
    """A trained network.

    Args:
        weights: arrays by the names of :data:`sysid.networks.cell.TENSORS`.
        loss: with the network on the recordings to select, in units of what it is without one.
    """

    weights: Mapping[str, Array]
    loss: float
    epochs: int


def train_recurrent(
    fit: Sequence[RecordingWindow], select: Sequence[RecordingWindow], bound: float, interval: float, integrates: bool,
    settings: RecurrentSettings | None = None, seed: int = 0, progress: Progress = silent,
) -> Recurrent:  # fmt: skip
    """Train on ``fit``, keep the weights that do best on ``select``.

    Args:
        integrates: whether ``left`` is the integral of what the network says.

    Raises:
        SettingsError: nothing to learn from.
    """
    import torch

    settings = settings or RecurrentSettings()
    joined = np.concatenate([part.inputs for part in fit]) if fit else np.empty((0, 1))
    if len(joined) < settings.warm or not select:
        raise SettingsError(
            "residual network", f"{len(joined)} looks to learn from", f"at least {settings.warm}, and some to select"
        )
    mean, spread = joined.mean(axis=0), joined.std(axis=0)
    scale = np.where(spread > 1e-9 * np.maximum(np.abs(mean), 1e-12), 1.0 / np.maximum(spread, 1e-300), 0.0)
    with _seeded(seed, settings.threads):
        cell = torch.nn.LSTM(joined.shape[1], settings.units, batch_first=True, dtype=torch.float64)
        head = torch.nn.Linear(settings.units, 1, dtype=torch.float64)
        with torch.no_grad():  # it begins with next to nothing to say
            head.weight *= 0.1
            head.bias.zero_()
        parameters = [*cell.parameters(), *head.parameters()]
        adam = torch.optim.Adam(parameters, lr=settings.learning_rate, weight_decay=settings.decay)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, settings.epochs, 0.05 * settings.learning_rate)
        learned, judged = (_pieces(parts, mean, scale, settings) for parts in (fit, select))
        units = _units(fit, bound, interval, integrates)

        def loss(pieces: tuple[Any, Any, Any, Any]) -> torch.Tensor:
            x, left, counts, size = pieces
            said = bound * size * torch.tanh(head(cell(x)[0])[..., 0])
            found: torch.Tensor = _loss(said, left, counts, interval, integrates, units)
            return found

        with torch.no_grad():
            nothing = float(_loss(0.0 * judged[1], judged[1], judged[2], interval, integrates, units))
        best, kept, waited, epoch = np.inf, [p.detach().clone() for p in parameters], 0, 0
        for epoch in range(1, settings.epochs + 1):
            adam.zero_grad()
            total = loss(learned)
            total.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(parameters, 1.0)
            adam.step()
            schedule.step()
            if epoch % settings.check_every:
                continue
            progress(epoch / settings.epochs, f"residual network, epoch {epoch}")
            with torch.no_grad():
                now = float(loss(judged))
            if now < best:
                best, kept, waited = now, [p.detach().clone() for p in parameters], 0
            else:
                waited += 1
                if waited >= settings.patience:
                    break
        W, U, b_in, b_state, w, w0 = (part.numpy().astype(np.float64) for part in kept)
    weights = {"mean": mean, "scale": scale, "W": W, "U": U, "b": b_in + b_state, "w": w[0], "w0": w0}
    return Recurrent(weights, best / nothing if nothing > 0.0 else np.inf, epoch)


def _loss(said: Any, left: Any, counts: Any, interval: float, integrates: bool, units: Sequence[float]) -> Any:
    """Huber's loss of what is left with the network, in the units of what is left without."""
    import torch

    terms = []
    if not integrates:
        terms.append(((left - said) / units[0], counts))
    else:
        moved = torch.cumsum(said, dim=1) * interval  # after each look; what stands at a look comes from those before it
        at = torch.nn.functional.pad(moved[:, :-1], (1, 0))
        rest = left - at
        for lag, unit in zip(LAGS, units, strict=True):
            terms.append(((rest[:, lag:] - rest[:, :-lag]) / unit, counts[:, lag:] & counts[:, :-lag]))
    usable = [error[there & torch.isfinite(error)] for error, there in terms]
    return sum(torch.nn.functional.huber_loss(value, torch.zeros_like(value), delta=3.0) for value in usable) / len(usable)


def _units(parts: Sequence[RecordingWindow], bound: float, interval: float, integrates: bool) -> tuple[float, ...]:
    """What is left over without a network: RMS of the changes over each lag, or of the values."""
    if not integrates:
        return (max(_rms(np.concatenate([p.left for p in parts])), 1e-6 * bound),)
    lagged = (np.concatenate([p.left[lag:] - p.left[:-lag] for p in parts]) for lag in LAGS)
    return tuple(max(_rms(values), 1e-6 * bound * interval) for values in lagged)


def _rms(values: Array) -> float:
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if len(there) else 0.0


def _pieces(
    parts: Sequence[RecordingWindow], mean: Array, scale: Array, settings: RecurrentSettings
) -> tuple[Any, Any, Any, Any]:
    """Pieces of equal length (k, warm + piece, …): inputs, what is left, whether a look counts (warm), size."""
    import torch

    inputs, left, counts, size, whole = [], [], [], [], settings.warm + settings.piece
    for part in parts:
        x = np.clip((part.inputs - mean) * scale, -REACH, REACH)
        for first in range(0, max(len(x) - LAGS[-1], 1), settings.piece):
            begin = max(first - settings.warm, 0)
            here = slice(begin, min(begin + whole, len(x)))
            missing = whole - (here.stop - here.start)
            inputs.append(np.pad(x[here], ((0, missing), (0, 0))))
            left.append(np.pad(part.left[here], (0, missing), constant_values=np.nan))
            size.append(np.pad(part.size[here], (0, missing)))
            counts.append(np.arange(begin, begin + whole) >= (first if first else 0))
    made = [torch.from_numpy(np.array(values)) for values in (inputs, left, counts, size)]
    return made[0], made[1], made[2], made[3]


@contextmanager
def _seeded(seed: int, threads: int) -> Iterator[None]:
    """The same seed gives the same network, and the caller's random numbers stay as they are."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            yield
    finally:
        torch.set_num_threads(before)
