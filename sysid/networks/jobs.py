"""Members prepared for training, and their grouping into batches.

Every member has its own shuffle order, learning rate and epochs: an epoch is a pass over its own rows, and whole batches are
taken from the endless sequence of passes. All matrices of an update therefore have one shape, whatever the numbers of rows:
rows are not padded or masked, there is no small last batch, and shapes (hence bits) do not depend on other members.

Initial weights and shuffle order follow from the seed and the member's name by a counter-based generator (Philox; Salmon et al.
2011), so any part of the order is available without the previous ones: a checkpoint holds no generator state, and the order is
the same on every device.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, SettingsError
from sysid.networks.batch import Floats, pack, padded, parameters
from sysid.networks.member import FORMAT, Checkpoints, EnsembleMember, State, TrainingSettings
from sysid.networks.mlp import Normalisation, Rectifier

if TYPE_CHECKING:
    import torch

Array = npt.NDArray[np.float64]


def generator(seed: int, name: str, pass_: int) -> np.random.Generator:
    """Generator of one member and one pass over its rows; pass 0 is for the initial weights."""
    # Python's hash() differs between processes.
    key = int.from_bytes(hashlib.blake2b(f"{seed} {name}".encode(), digest_size=16).digest(), "little")
    return np.random.Generator(np.random.Philox(key=key, counter=[0, 0, 0, pass_]))


def initial_row(seed: int, name: str, sizes: tuple[int, ...]) -> Floats:
    """Initial weights and biases, uniform in ±1/√in as in ``torch.nn.Linear``, (P,) with padding."""
    rng = generator(seed, name, 0)
    weights, biases = [], []
    for d_in, d_out in itertools.pairwise(sizes):
        drawn = (rng.random((d_in + 1, d_out), dtype=np.float32) * 2.0 - 1.0) / np.float32(math.sqrt(d_in))
        weights.append(drawn[:-1])
        biases.append(drawn[-1])
    return pack(sizes, weights, biases)


class ShuffleOrder:
    """The endless shuffled sequence of a member's rows: one permutation per pass."""

    def __init__(self, seed: int, name: str, rows: int) -> None:
        self._seed, self._name, self._rows = seed, name, rows
        self._pass, self._permutation = 0, np.empty(0, dtype=np.int64)

    def take(self, begin: int, end: int) -> npt.NDArray[np.int64]:
        """The row numbers at positions ``begin`` to ``end`` (excluded) of the sequence."""
        parts = []
        for pass_ in range(begin // self._rows, -(-end // self._rows)):
            first = pass_ * self._rows
            parts.append(self._permutation_of(pass_ + 1)[max(begin - first, 0) : end - first])
        return np.concatenate(parts)

    def _permutation_of(self, pass_: int) -> npt.NDArray[np.int64]:
        if pass_ != self._pass:
            self._pass, self._permutation = pass_, generator(self._seed, self._name, pass_).permutation(self._rows)
        return self._permutation


#: Largest working set of one batch on a CPU [bytes]: more members per batch save calls while they fit the caches.
CACHE = 6_000_000


@dataclass(frozen=True)
class Job:
    """One member: normalised rows, padded columns, settings and state.

    Args:
        sizes: (d_in, hidden…, d_out) without padding.
        x, y: fit rows, (n, padded d).
        x_validation, y_validation: (v, padded d).
        width: rows per update, at most n.
        settings: with the member's own learning rate.
        file: name of the checkpoint.
    """

    name: str
    sizes: tuple[int, ...]
    x: Floats
    y: Floats
    x_validation: Floats
    y_validation: Floats
    order: ShuffleOrder
    width: int
    settings: TrainingSettings
    state: State
    file: str = ""
    rectifier: Rectifier = "relu"

    @property
    def updates(self) -> int:
        """Largest number of updates."""
        return math.ceil(self.settings.epochs * len(self.x) / self.width)

    @property
    def shape(self) -> tuple[object, ...]:
        """Jobs with equal values can share a batch."""
        return (padded(self.sizes), self.rectifier, self.width, self.state.step)

    @property
    def bytes(self) -> int:
        """Size of parameters, gradients, moments, and activations with their gradients."""
        return 16 * len(self.state.row) + 8 * self.width * sum(padded(self.sizes))

    def rate(self, step: int) -> float:
        """Learning rate of update ``step``, counted from 1: constant, or a cosine down to a hundredth."""
        if self.settings.schedule == "constant":
            return self.settings.learning_rate
        share = 0.5 * (1.0 + math.cos(math.pi * (step - 1) / max(1, self.updates - 1)))
        return self.settings.learning_rate * (0.01 + 0.99 * share)

    def epoch(self, step: int) -> int:
        """Whole passes after ``step`` updates."""
        return min(self.settings.epochs, step * self.width // len(self.x))

    def is_due(self, step: int) -> bool:
        """Whether the member is evaluated after update ``step``."""
        every = self.settings.check_every
        return self.epoch(step) // every > self.epoch(step - 1) // every or step >= self.updates

    def record_check(self, validation: float, row: Callable[[], Floats]) -> None:
        """Record an evaluation: its ``validation`` loss, and the parameters ``row()`` if it is the best.

        Raises:
            SettingsError: a loss that is not finite.
        """
        state, epoch, fit = self.state, self.epoch(self.state.step), self.state.loss / self.state.seen
        if not (math.isfinite(validation) and math.isfinite(fit)):
            raise SettingsError(
                f"network {self.name}",
                f"the loss became {fit if math.isfinite(validation) else validation} by epoch {epoch}",
                "a finite loss",
                f"Lower learning_rate (now {self.settings.learning_rate:g}).",
            )
        state.epochs.append(epoch)
        state.fit.append(fit)
        state.validation.append(validation)
        state.loss, state.seen = 0.0, 0
        if validation < state.best_loss:
            state.best_loss, state.best_epoch, state.best = validation, epoch, row()
        state.finished = state.step >= self.updates or epoch - state.best_epoch >= self.settings.patience


def batches(jobs: Sequence[Job], workers: int, device: torch.device) -> list[list[Job]]:
    """Batches of jobs with one shape, as large as the caches allow and small enough to occupy every worker."""
    found = []
    waiting = sorted(
        (job for job in jobs if not job.state.finished),
        key=lambda job: (str(job.shape), job.settings.learning_rate, len(job.x)),
    )
    for _, group in itertools.groupby(waiting, key=lambda job: job.shape):
        members = list(group)
        size = len(members)
        if device.type == "cpu":
            size = max(1, min(CACHE // members[0].bytes, math.ceil(size / workers)))
        count = math.ceil(len(members) / size)
        parts = [members[number * len(members) // count : (number + 1) * len(members) // count] for number in range(count)]
        found += [part for part in parts if part]
    return sorted(found, key=remaining_work, reverse=True)  # the longest first, to balance the workers


def remaining_work(batch: Sequence[Job]) -> float:
    return float(sum((job.updates - job.state.step) * job.bytes for job in batch))


def layers_of(member: EnsembleMember, hidden: tuple[int, ...]) -> tuple[int, ...]:
    """(d_in, hidden…, d_out) of a member, after checks of its arrays and settings."""
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
    hidden = hidden if member.hidden is None else member.hidden
    if not hidden or any(units < 1 for units in hidden):
        raise SettingsError("training", f"hidden = {list(hidden)}", "at least one layer with at least one unit")
    rate = member.learning_rate
    if rate is not None and not (math.isfinite(rate) and rate > 0.0):
        raise SettingsError(f"network {member.name}", f"learning_rate = {rate}", "a positive number")
    return (d_in, *hidden, d_out)


def scalers_of(member: EnsembleMember) -> tuple[Normalisation, Normalisation]:
    where = f"network {member.name}"
    inputs = Normalisation.of(member.inputs, member.input_names, where)
    return inputs, Normalisation.of(member.outputs, member.output_names, where)


def job_of(
    member: EnsembleMember,
    sizes: tuple[int, ...],
    scalers: tuple[Normalisation, Normalisation],
    settings: TrainingSettings,
    seed: int,
    device: str,
    checkpoints: Checkpoints | None,
) -> Job:
    inputs, outputs = scalers
    rows = [
        _padded_columns(inputs.apply(member.inputs), sizes[0]),
        _padded_columns(outputs.apply(member.outputs), sizes[-1]),
        _padded_columns(inputs.apply(member.validation_inputs), sizes[0]),
        _padded_columns(outputs.apply(member.validation_outputs), sizes[-1]),
    ]
    rate = settings.learning_rate if member.learning_rate is None else member.learning_rate
    own = replace(settings, learning_rate=rate)
    file = _checkpoint_name(member, sizes, own, seed, device, rows) if checkpoints else ""
    saved = checkpoints.load(file, parameters(padded(sizes))) if checkpoints else None
    return Job(
        name=member.name,
        sizes=sizes,
        x=rows[0],
        y=rows[1],
        x_validation=rows[2],
        y_validation=rows[3],
        order=ShuffleOrder(seed, member.name, len(rows[0])),
        width=min(settings.batch, len(rows[0])),
        settings=own,
        state=saved or State.at_start(initial_row(seed, member.name, sizes)),
        file=file,
        rectifier=member.rectifier,
    )


def _padded_columns(values: Array, columns: int) -> Floats:
    """(n, d) with columns padded by zeros to a whole lane."""
    filled = np.zeros((len(values), padded((columns,))[0]), dtype=np.float32)
    filled[:, :columns] = values
    return filled


def _checkpoint_name(
    member: EnsembleMember, sizes: tuple[int, ...], settings: TrainingSettings, seed: int, device: str, rows: Sequence[Floats]
) -> str:
    """Name of a member's checkpoint: a digest of all that its result depends on."""
    import torch

    decides = asdict(settings) | {
        "threads": None,
        "device": device,
        "format": FORMAT,
        "member": member.name,
        "rectifier": member.rectifier,
        "sizes": sizes,
        "seed": seed,
    }
    versions = {"torch": torch.__version__, "numpy": np.__version__}
    digest = hashlib.sha256(json.dumps(decides | versions, sort_keys=True).encode())
    for values in rows:
        digest.update(f"{values.shape}".encode() + np.ascontiguousarray(values).tobytes())
    return "".join(letter if letter.isalnum() else "-" for letter in member.name)[:60] + f"-{digest.hexdigest()[:24]}"
