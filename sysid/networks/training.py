"""Training of all networks: members with equal layers are trained together as one batch of matrix products.

Adam (Kingma & Ba 2015) on the mean squared error of normalised outputs. Every ``check_every`` epochs each member is evaluated
on its own validation rows; its best weights are kept, and a member that has not improved for ``patience`` epochs is finished.
On a CPU a member's result has the same bits whatever the other members, the number of threads and the interruptions.
"""

from __future__ import annotations

import math
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from sysid.cores import cores
from sysid.errors import SettingsError
from sysid.networks.batch import BatchedAdam, BatchedMlp, Floats, Stack, padded, parameters, unpack
from sysid.networks.jobs import Job, batches, job_of, layers_of, remaining_work, scalers_of
from sysid.networks.member import Checkpoints, EnsembleMember, LearningCurve, TrainedMember, TrainingSettings
from sysid.networks.mlp import Mlp, Normalisation
from sysid.progress import Progress, silent

if TYPE_CHECKING:
    import torch


#: Rows per block of the validation prediction: a shape that does not depend on the other members.
BLOCK = 128


class TrainingStopped(Exception):  # noqa: N818  (requested, not an error)
    """Training was stopped on request after writing its checkpoints."""


@dataclass
class Control:
    """Checkpoint folder and stop flag, shared by all batches."""

    checkpoints: Checkpoints | None = None
    stop: threading.Event = field(default_factory=threading.Event)


def train_batches(
    work: Sequence[Sequence[Job]],
    workers: int,
    device: torch.device,
    control: Control,
    report: Callable[[float, str], None],
) -> None:
    """Train every batch, ``workers`` at a time; results are in the states of the jobs.

    Raises:
        The first error of a batch, or an interrupt of the caller; the other batches have then written their checkpoints.
    """
    import torch

    cost, done = [remaining_work(batch) for batch in work], [0.0] * len(work)
    share = [each / sum(cost) for each in cost]
    messages: queue.SimpleQueue[tuple[int, float, BaseException | None]] = queue.SimpleQueue()

    def one(number: int) -> None:
        try:
            if not control.stop.is_set():
                train_batch(work[number], device, control, lambda part: messages.put((number, part, None)))
            messages.put((number, 1.0, None))
        except BaseException as error:
            control.stop.set()
            messages.put((number, 1.0, error))

    # One thread and core per batch: torch releases the GIL, and its own threads would synchronise at every small product.
    # Progress and signals are handled in the caller's thread.
    with ThreadPoolExecutor(workers, "training", lambda: torch.set_num_threads(1)) as pool:
        try:
            left = len([pool.submit(one, number) for number in range(len(work))])
            failed: BaseException | None = None
            while left:
                number, part, error = messages.get()
                left -= part == 1.0
                failed = failed or (None if isinstance(error, TrainingStopped) else error)
                done[number] = max(done[number], part)
                if not failed:
                    whole = math.fsum(a * b for a, b in zip(share, done, strict=True)) if left else 1.0
                    report(min(1.0, whole), _names(work[number]))
        finally:
            control.stop.set()
    if failed:
        raise failed


def _names(batch: Sequence[Job]) -> str:
    first = ", ".join(job.name for job in batch[:4])
    return first if len(batch) <= 4 else f"{first} and {len(batch) - 4} more"


def train_batch(jobs: Sequence[Job], device: torch.device, control: Control, report: Callable[[float], None]) -> None:
    """Train jobs of one shape until all are finished.

    Raises:
        SettingsError: a loss that is not finite.
        StorageError: a checkpoint cannot be written.
        TrainingStopped: ``control.stop`` is set.
    """
    import torch

    with torch.no_grad():
        run, clock = _Batch(list(jobs), device), time.monotonic()
        while run.jobs:
            step = run.step()
            due = [k for k, job in enumerate(run.jobs) if job.is_due(step)]
            if due:
                run.check(due)
                report(min(0.999, max(step / job.updates for job in run.jobs)))
            if control.checkpoints and (control.stop.is_set() or time.monotonic() - clock >= control.checkpoints.every):
                run.save(control.checkpoints)
                clock = time.monotonic()
            if due and any(run.jobs[k].state.finished for k in due):
                if control.checkpoints:
                    run.save(control.checkpoints, [k for k in due if run.jobs[k].state.finished])
                run = run.without_finished()
            if run.jobs and control.stop.is_set():
                raise TrainingStopped


class _Batch:
    """Jobs of one shape on a device."""

    def __init__(self, jobs: list[Job], device: torch.device, moved: tuple[BatchedMlp, BatchedAdam] | None = None) -> None:
        import torch

        self.jobs, self.device = jobs, device
        if not jobs:
            return
        sizes, states = padded(jobs[0].sizes), [job.state for job in jobs]
        if moved is None:
            self.model = BatchedMlp.of_rows(sizes, [state.row for state in states], device, jobs[0].rectifier)
            first, second = (Stack.of_rows(sizes, [getattr(s, key) for s in states], device) for key in ("first", "second"))
            self.adam = BatchedAdam(first, second, states[0].step)
        else:
            self.model, self.adam = moved
        self.x, self.y = (
            torch.from_numpy(np.concatenate([getattr(job, key) for job in jobs])).to(device) for key in ("x", "y")
        )
        self.begins = np.cumsum([0, *(len(job.x) for job in jobs[:-1])])
        self.outputs = torch.tensor([float(job.sizes[-1]) for job in jobs], device=device)[:, None, None]
        self.loss = torch.tensor([state.loss for state in states], dtype=torch.float64, device=device)
        self.width = jobs[0].width
        self.chosen = [values.new_empty((len(jobs) * self.width, values.shape[1])) for values in (self.x, self.y)]
        self.prefetch = max(1, math.ceil(max(len(job.x) for job in jobs) / self.width))
        self.prefetched = (0, 0)

    def step(self) -> int:
        """One update of all members; returns its number."""
        import torch

        before = self.jobs[0].state.step
        if not self.prefetched[0] <= before < self.prefetched[1]:
            self.prefetched = (before, before + self.prefetch)
            self._prefetch_rows()
        chosen = self.rows[before - self.prefetched[0]]
        shape = (len(self.jobs), self.width, -1)
        torch.index_select(self.x, 0, chosen, out=self.chosen[0])
        torch.index_select(self.y, 0, chosen, out=self.chosen[1])
        self.loss += self.model.accumulate(self.chosen[0].view(shape), self.chosen[1].view(shape), self.outputs)
        self.adam.step(self.model, [job.rate(before + 1) for job in self.jobs])
        for job in self.jobs:
            job.state.step += 1
            job.state.seen += 1
        return before + 1

    def _prefetch_rows(self) -> None:
        """Row numbers of the next updates, (prefetch, m·width), moved to the device at once."""
        import torch

        begin, end = (at * self.width for at in self.prefetched)
        taken = [
            job.order.take(begin, end).reshape(-1, self.width) + offset
            for job, offset in zip(self.jobs, self.begins, strict=True)
        ]
        self.rows = torch.from_numpy(np.stack(taken, axis=1).reshape(self.prefetch, -1)).to(self.device)

    def check(self, due: list[int]) -> None:
        """Evaluate the members ``due`` on their validation rows."""
        for k, validation, loss in zip(due, self._validation(due), self.loss[due].tolist(), strict=True):
            self.jobs[k].state.loss = loss
            self.jobs[k].record_check(validation, lambda k=k: self.model.parameters.row(k))  # type: ignore[misc]
        self.loss[due] = 0.0

    def _validation(self, due: list[int]) -> list[float]:
        """Mean squared error on the validation rows of each of ``due``."""
        import torch

        totals = dict.fromkeys(due, 0.0)
        for begin in range(0, max(len(self.jobs[k].x_validation) for k in due), BLOCK):
            present = [k for k in due if begin < len(self.jobs[k].x_validation)]
            parts = [
                [_block(values, begin) for values in (self.jobs[k].x_validation, self.jobs[k].y_validation)] for k in present
            ]
            x, y = (torch.from_numpy(np.stack(values)).to(self.device) for values in zip(*parts, strict=True))
            error = self.model.predict(x, None if len(present) == len(self.jobs) else present).sub_(y)
            for row, k in enumerate(present):
                error[row, len(self.jobs[k].x_validation) - begin :] = 0.0
            for k, total in zip(present, error.square().sum(dim=1).double().sum(dim=1).tolist(), strict=True):
                totals[k] += total
        return [totals[k] / self.jobs[k].x_validation.shape[0] / self.jobs[k].sizes[-1] for k in due]

    def save(self, checkpoints: Checkpoints, members: Sequence[int] | None = None) -> None:
        """Update the states of ``members`` (default: all) and write their checkpoints."""
        losses = self.loss.tolist()
        for k in range(len(self.jobs)) if members is None else members:
            state = self.jobs[k].state
            state.row, state.first, state.second = (
                stack.row(k) for stack in (self.model.parameters, self.adam.first, self.adam.second)
            )
            state.loss = losses[k]
            checkpoints.save(self.jobs[k].file, state)

    def without_finished(self) -> _Batch:
        """The batch of the other members; their results do not change."""
        stay = [k for k, job in enumerate(self.jobs) if not job.state.finished]
        if not stay:
            return _Batch([], self.device)
        for k, loss in zip(stay, self.loss[stay].tolist(), strict=True):
            self.jobs[k].state.loss = loss
        sizes = self.model.sizes
        room = Stack.zeros(sizes, len(stay), self.device)
        model = BatchedMlp(sizes, self.model.parameters.kept(sizes, stay), room, self.model.rectifier)
        adam = BatchedAdam(self.adam.first.kept(sizes, stay), self.adam.second.kept(sizes, stay), self.jobs[0].state.step)
        return _Batch([self.jobs[k] for k in stay], self.device, (model, adam))


def _block(values: Floats, begin: int) -> Floats:
    """Rows ``begin`` to ``begin + BLOCK``, padded with zeros."""
    part = values[begin : begin + BLOCK]
    return np.pad(part, ((0, BLOCK - len(part)), (0, 0)))


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
