"""One training engine for every network: members of equal shape are trained together as one batch of matrix products.

Adam (Kingma & Ba 2015) on the mean squared error of normalised outputs. Every ``check_every`` epochs each member is judged on
its own validation rows; its best weights are kept, and a member that has not improved for ``patience`` epochs is finished.
Members share nothing but the batch: each has its own initial weights and its own order of samples, both drawn from the seed and
the member's name.
"""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from sysid.config import STRICT
from sysid.errors import InputError, SettingsError
from sysid.networks.batch import BatchedMlp, FusedAdam, unpack
from sysid.networks.mlp import Mlp, Normalisation
from sysid.progress import Progress, part, silent

if TYPE_CHECKING:
    import torch

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class TrainingSettings:
    """How a network is trained.

    Args:
        learning_rate: of Adam, at the start.
        batch: rows per step.
        epochs: passes over the rows at most.
        patience: epochs without improvement on the validation rows before a member is finished.
        check_every: epochs between two looks at the validation rows.
        schedule: ``constant``, or ``cosine`` down to a hundredth at the last epoch.
        threads: of torch. Fixed, because the order of a sum depends on it and the same seed must give the same network.
    """

    __pydantic_config__ = STRICT

    learning_rate: float
    batch: int = 64
    epochs: int = 500
    patience: int = 100
    check_every: int = 5
    schedule: Literal["constant", "cosine"] = "constant"
    threads: int = 1

    def check(self, where: object) -> None:
        """Raises SettingsError for a value that cannot be used."""
        for key in ("learning_rate", "batch", "epochs", "patience", "check_every", "threads"):
            value = getattr(self, key)
            if not (math.isfinite(value) and value > 0):
                raise SettingsError(where, f"{key} = {value}", "a positive number")


@dataclass(frozen=True)
class Member:
    """One network to train: rows in SI units.

    Args:
        name: decides, with the seed, the initial weights and the order of samples; shown in messages.
        inputs, outputs: rows to learn from, (n, d_in) and (n, d_out).
        validation_inputs, validation_outputs: rows that decide when to stop, (v, d_in) and (v, d_out).
        input_names, output_names: of the columns, for messages.
    """

    name: str
    inputs: Array
    outputs: Array
    validation_inputs: Array
    validation_outputs: Array
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]


@dataclass(frozen=True)
class Course:
    """How a training went.

    Args:
        rows: learned from and validated on.
        epochs: passes made until it was finished.
        best_epoch: the one whose weights were kept.
        validation_rmse: per output at ``best_epoch`` [SI].
        checked_epochs, fit_loss, validation_loss: (k,) each; losses are mean squared errors of normalised outputs.
        seconds: wall time of the batch it was trained in.
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
        """Without the wall time, which differs between runs that are otherwise equal."""
        return {key: value for key, value in asdict(self).items() if key != "seconds"}


@dataclass(frozen=True)
class Trained:
    """A trained member: the network with the weights of its best epoch, and how it came about."""

    mlp: Mlp
    course: Course


def train(
    members: Sequence[Member],
    hidden: tuple[int, ...],
    settings: TrainingSettings,
    seed: int,
    progress: Progress | None = None,
) -> tuple[Trained, ...]:
    """Train every member; those with equal numbers of rows and columns run in one batch.

    Args:
        hidden: units of the hidden layers.
        progress: called at every check with the share of epochs done of those at most needed, and who is being trained.

    Returns:
        One result a member, in their order.

    Raises:
        InputError: rows that are not finite, or whose numbers do not match.
        ExcitationError: a column that does not vary.
        SettingsError: settings that cannot be used, or with which training diverges.
    """
    settings.check("training")
    if not hidden or any(units < 1 for units in hidden):
        raise SettingsError("training", f"hidden = {list(hidden)}", "at least one layer with at least one unit")
    groups: dict[tuple[int, ...], list[int]] = {}
    for position, member in enumerate(members):
        groups.setdefault(_shape(member), []).append(position)
    results: dict[int, Trained] = {}
    with _threads(settings.threads):
        for number, positions in enumerate(groups.values()):
            batch = [members[position] for position in positions]
            tell = part(progress or silent, number / len(groups), (number + 1) / len(groups))
            results.update(zip(positions, _train_batch(batch, hidden, settings, seed, tell), strict=True))
    return tuple(results[position] for position in range(len(members)))


def _shape(member: Member) -> tuple[int, ...]:
    """(n, d_in, d_out, v) of a member whose arrays fit together and are finite."""
    (n, d_in), (v, _), d_out = member.inputs.shape, member.validation_inputs.shape, member.outputs.shape[1]
    expected = {"inputs": (n, d_in), "outputs": (n, d_out), "validation_inputs": (v, d_in), "validation_outputs": (v, d_out)}
    for key, shape in expected.items():
        values = getattr(member, key)
        if values.shape != shape or 0 in shape:
            raise InputError(f"network {member.name}: {key}", f"shape {values.shape}", f"{shape} with at least one row")
        if not np.isfinite(values).all():
            count = int((~np.isfinite(values)).sum())
            raise InputError(
                f"network {member.name}: {key}", f"{count} values are NaN or infinite", "finite numbers", "Drop those rows."
            )
    return n, d_in, d_out, v


@contextmanager
def _threads(count: int) -> Iterator[None]:
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _train_batch(
    members: list[Member], hidden: tuple[int, ...], settings: TrainingSettings, seed: int, progress: Progress
) -> list[Trained]:
    import torch

    start = time.perf_counter()
    text = ", ".join(member.name for member in members)
    scalers = [
        (
            Normalisation.of(member.inputs, member.input_names, f"network {member.name}"),
            Normalisation.of(member.outputs, member.output_names, f"network {member.name}"),
        )
        for member in members
    ]
    x, y, x_validation, y_validation = (
        torch.from_numpy(np.stack(arrays).astype(np.float32))
        for arrays in zip(
            *(
                (
                    inputs.apply(member.inputs),
                    outputs.apply(member.outputs),
                    inputs.apply(member.validation_inputs),
                    outputs.apply(member.validation_outputs),
                )
                for member, (inputs, outputs) in zip(members, scalers, strict=True)
            ),
            strict=True,
        )
    )
    generators = [_generator(seed, member.name) for member in members]
    sizes = (x.shape[2], *hidden, y.shape[2])
    model = BatchedMlp.initial(sizes, generators)
    adam = FusedAdam(model, settings.learning_rate)
    watch = _EarlyStopping(len(members), settings.patience)
    running = list(range(len(members)))
    n = x.shape[1]
    with torch.no_grad():
        for epoch in range(1, settings.epochs + 1):
            learning_rate = _learning_rate(settings, epoch)
            order = torch.stack([torch.randperm(n, generator=generators[member]) for member in running])
            rows = torch.tensor(running)[:, None]
            total = torch.zeros(len(running))
            for first in range(0, n, settings.batch):
                chosen = order[:, first : first + settings.batch]
                losses = model.accumulate(x[rows, chosen], y[rows, chosen])
                adam.step(learning_rate)
                total += losses * chosen.shape[1]
            if epoch % settings.check_every and epoch != settings.epochs:
                continue
            validation = (model.predict(x_validation[running]) - y_validation[running]).square().mean(dim=(1, 2))
            _refuse_divergence([members[member] for member in running], validation, total / n, epoch, settings)
            finished = watch.update(epoch, running, total / n, validation, model.parameters)
            progress(epoch / settings.epochs, text)
            if finished:
                stay = [position for position, member in enumerate(running) if member not in finished]
                running = [running[position] for position in stay]
                if not running:
                    break
                model, adam = adam.kept(model, stay)
    progress(1.0, text)
    seconds = time.perf_counter() - start
    return [_result(member, sizes, scalers[k], watch.records[k], seconds) for k, member in enumerate(members)]


def _result(
    member: Member, sizes: tuple[int, ...], scalers: tuple[Normalisation, Normalisation], record: _Record, seconds: float
) -> Trained:
    mlp = Mlp(*unpack(sizes, record.best_parameters), *scalers)
    residual = mlp.predict(member.validation_inputs) - member.validation_outputs
    course = Course(
        rows=(len(member.inputs), len(member.validation_inputs)),
        epochs=record.epochs[-1],
        best_epoch=record.best_epoch,
        validation_rmse=tuple(np.sqrt((residual**2).mean(axis=0)).tolist()),
        checked_epochs=tuple(record.epochs),
        fit_loss=tuple(record.fit),
        validation_loss=tuple(record.validation),
        seconds=seconds,
    )
    return Trained(mlp, course)


@dataclass
class _Record:
    """What has been seen of one member so far."""

    epochs: list[int] = field(default_factory=list)
    fit: list[float] = field(default_factory=list)
    validation: list[float] = field(default_factory=list)
    best_epoch: int = 0
    best_loss: float = math.inf
    best_parameters: Array = field(default_factory=lambda: np.empty(0))


class _EarlyStopping:
    """Best weights of each member, and which of them are finished."""

    def __init__(self, members: int, patience: int) -> None:
        self.records = [_Record() for _ in range(members)]
        self._patience = patience

    def update(
        self, epoch: int, running: list[int], fit: torch.Tensor, validation: torch.Tensor, parameters: torch.Tensor
    ) -> set[int]:
        """Note the losses of the ``running`` members; returns those that are finished."""
        finished = set()
        for position, member in enumerate(running):
            record, loss = self.records[member], float(validation[position])
            record.epochs.append(epoch)
            record.fit.append(float(fit[position]))
            record.validation.append(loss)
            if loss < record.best_loss:
                record.best_loss, record.best_epoch = loss, epoch
                record.best_parameters = parameters[position].numpy().astype(np.float64)
            elif epoch - record.best_epoch >= self._patience:
                finished.add(member)
        return finished


def _generator(seed: int, name: str) -> torch.Generator:
    import torch

    # Not Python's hash(), which differs between processes; and 32 bits, since torch's generator ignores the rest.
    return torch.Generator().manual_seed(zlib.crc32(f"{seed} {name}".encode()))


def _learning_rate(settings: TrainingSettings, epoch: int) -> float:
    if settings.schedule == "constant":
        return settings.learning_rate
    share = 0.5 * (1.0 + math.cos(math.pi * (epoch - 1) / max(1, settings.epochs - 1)))
    return settings.learning_rate * (0.01 + 0.99 * share)


def _refuse_divergence(
    members: list[Member], validation: torch.Tensor, fit: torch.Tensor, epoch: int, settings: TrainingSettings
) -> None:
    for member, loss, fit_loss in zip(members, validation.tolist(), fit.tolist(), strict=True):
        if not (math.isfinite(loss) and math.isfinite(fit_loss)):
            raise SettingsError(
                f"network {member.name}",
                f"the loss became {loss if not math.isfinite(loss) else fit_loss} by epoch {epoch}",
                "a finite loss",
                f"Lower learning_rate (now {settings.learning_rate:g}).",
            )
