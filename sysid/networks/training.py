"""Training of all networks: members with equal layers are trained together as one batch of matrix products.

Adam (Kingma & Ba 2015) on the mean squared error of normalised outputs. Every ``check_every`` epochs each member is evaluated
on its own validation rows; its best weights are kept, and a member that has not improved for ``patience`` epochs is finished.
On a CPU a member's result has the same bits whatever the other members, the number of threads and the interruptions.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from sysid.cores import cores
from sysid.errors import SettingsError
from sysid.networks.batch import padded, parameters, unpack
from sysid.networks.checkpoint import Checkpoints
from sysid.networks.engine import Control, train_batches
from sysid.networks.jobs import Job, batches, job_of, layers_of, scalers_of
from sysid.networks.member import EnsembleMember, LearningCurve, TrainedMember, TrainingSettings
from sysid.networks.mlp import Mlp, Normalisation
from sysid.progress import Progress, silent

if TYPE_CHECKING:
    import torch

#: Multiply-adds per update from which a GPU is faster.
MIN_GPU_WORK = 20_000_000


def train(
    members: Sequence[EnsembleMember],
    hidden: tuple[int, ...],
    settings: TrainingSettings,
    seed: int,
    progress: Progress | None = None,
    checkpoints: Checkpoints | None = None,
) -> tuple[TrainedMember, ...]:
    """Train every member; those with equal layers share a batch, whatever their rows and learning rates.

    Args:
        hidden: units of the hidden layers of members without their own.
        progress: called in this thread at every evaluation with the completed share and the names of the members.
        checkpoints: of an interrupted training (Ctrl-C, SIGTERM, crash); the same call resumes and ends with the same bits.
            They are removed on success and on divergence.

    Returns:
        One result per member, in their order.

    Raises:
        InputError: rows that are not finite, or of different numbers.
        ExcitationError: a constant column.
        SettingsError: invalid settings, or divergence.
        StorageError: a checkpoint cannot be written; the previous one stays.
    """
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    start = time.perf_counter()
    settings.check("training")
    layers = [layers_of(member, hidden) for member in members]
    scalers = [scalers_of(member) for member in members]
    device = _device(settings, members, layers)
    jobs = [job_of(*each, settings, seed, device.type, checkpoints) for each in zip(members, layers, scalers, strict=True)]
    workers = (settings.threads or cores()) if device.type == "cpu" else 1
    files = {job.file for job in jobs}
    try:
        with one_thread(), _interruptible(checkpoints is not None):
            work = batches(jobs, workers, device)
            train_batches(work, workers, device, Control(checkpoints), progress or silent)
    except SettingsError:  # diverged: resuming would diverge again
        _remove(checkpoints, files)
        raise
    _remove(checkpoints, files)
    seconds = time.perf_counter() - start
    with threadpool_limits(1, "blas"):  # threads of the BLAS are slower for products this small
        return tuple(_result(*each, seconds) for each in zip(members, jobs, scalers, strict=True))


def _device(settings: TrainingSettings, members: Sequence[EnsembleMember], layers: Sequence[tuple[int, ...]]) -> torch.device:
    """Device of the training; for ``auto`` the multiply-adds of one update of all members decide."""
    import torch

    if settings.device == "cuda" and not torch.cuda.is_available():
        raise SettingsError("training", "device = 'cuda', which torch does not find", "a GPU", "Use 'auto' or 'cpu'.")
    if settings.device != "auto":
        return torch.device(settings.device)
    each = (min(settings.batch, len(m.inputs)) * parameters(padded(sizes)) for m, sizes in zip(members, layers, strict=True))
    return torch.device("cuda" if torch.cuda.is_available() and sum(each) >= MIN_GPU_WORK else "cpu")


def _remove(checkpoints: Checkpoints | None, files: set[str]) -> None:
    if checkpoints is not None:
        for file in files:
            checkpoints.remove(file)


@contextmanager
def one_thread() -> Iterator[None]:
    """Set torch to one thread; restored for the caller."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def _interruptible(wanted: bool) -> Iterator[None]:
    """Make SIGTERM raise SystemExit, so that checkpoints are written; an existing handler of the program stays."""
    here = threading.current_thread() is threading.main_thread()
    if not (wanted and here and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL):
        yield
        return

    def leave(number: int, _: object) -> None:
        raise SystemExit(128 + number)

    signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _result(member: EnsembleMember, job: Job, scalers: tuple[Normalisation, Normalisation], seconds: float) -> TrainedMember:
    state = job.state
    mlp = Mlp(*unpack(job.sizes, state.best), *scalers, job.rectifier)
    residual = mlp.predict(member.validation_inputs) - member.validation_outputs
    curve = LearningCurve(
        rows=(len(member.inputs), len(member.validation_inputs)),
        epochs=state.epochs[-1],
        best_epoch=state.best_epoch,
        validation_rmse=tuple(np.sqrt((residual**2).mean(axis=0)).tolist()),
        checked_epochs=tuple(state.epochs),
        fit_loss=tuple(state.fit),
        validation_loss=tuple(state.validation),
        seconds=seconds,
    )
    return TrainedMember(mlp, curve)
