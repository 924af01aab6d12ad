"""Training callbacks: a file of JSON lines, TensorBoard, an MLflow server.

They do not influence training. After an interruption, training repeats the records since its checkpoint with the same values at
the same steps; each observer stores them once.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Protocol

from sysid.errors import SettingsError
from sysid.extras import install_remedy
from sysid.names import dotted
from sysid.root import Root
from sysid_rl.train.ddpg import Trainer


class Observer(Protocol):
    """Records every episode and evaluation while its context is open."""

    def opened(self, folder: Path, trainer: Trainer) -> AbstractContextManager[None]: ...

    def record(self, kind: str, step: int, figures: Mapping[str, float]) -> None: ...


@dataclass
class JsonLines:
    """One line for each episode or evaluation: ``{"kind": …, "step": …, figures}``, those of the checkpoint first."""

    path: Path
    _file: IO[str] | None = field(default=None, repr=False)

    @contextmanager
    def opened(self, folder: Path, trainer: Trainer) -> Iterator[None]:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("w", encoding="utf-8") as self._file:
            for kind, entries in (("episode", trainer.episodes), ("evaluation", trainer.evaluations)):
                for entry in entries:
                    self._write({"kind": kind, **entry})
            yield
        self._file = None

    def record(self, kind: str, step: int, figures: Mapping[str, float]) -> None:
        self._write({"kind": kind, "step": step, **figures})

    def _write(self, line: Mapping[str, Any]) -> None:
        assert self._file is not None
        self._file.write(json.dumps(line) + "\n")
        self._file.flush()


@dataclass
class TensorBoard:
    """Event files below ``folder``; those of an interrupted run are purged from the step at which it continues."""

    folder: Path
    _writer: Any = field(default=None, repr=False)

    @contextmanager
    def opened(self, folder: Path, trainer: Trainer) -> Iterator[None]:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            found, remedy = "tensorboard is not installed", install_remedy("tensorboard")
            raise SettingsError("sysid train --tensorboard", found, "the extra", remedy) from None
        step = trainer.step_count * trainer.environment.size
        self._writer = SummaryWriter(str(Root(self.folder).make(folder.name)), purge_step=step + 1 if step else None)
        try:
            yield
        finally:
            self._writer.close()

    def record(self, kind: str, step: int, figures: Mapping[str, float]) -> None:
        for name, value in figures.items():
            self._writer.add_scalar(f"{kind}/{name}", value, step)


@dataclass
class MlflowRun:
    """A run of the experiment ``policies`` at ``uri``; an interrupted training continues its run."""

    uri: str
    _client: Any = field(default=None, repr=False)
    _run: str = field(default="", repr=False)

    @contextmanager
    def opened(self, folder: Path, trainer: Trainer) -> Iterator[None]:
        from mlflow.tracking import MlflowClient

        self._client = MlflowClient(self.uri)
        found = self._client.get_experiment_by_name("policies")
        experiment = found.experiment_id if found is not None else self._client.create_experiment("policies")
        runs = self._client.search_runs([experiment], f"tags.training = '{folder.name}'", max_results=1)
        if runs:
            self._run = runs[0].info.run_id
            self._client.update_run(self._run, status="RUNNING")
        else:
            recipe = trainer.recipe
            name = f"{recipe.name} seed {recipe.seed}"
            self._run = self._client.create_run(experiment, tags={"training": folder.name}, run_name=name).info.run_id
            for key, value in dotted(recipe.to_json()):
                self._client.log_param(self._run, key, value)
        try:
            yield
        except BaseException:
            self._client.set_terminated(self._run, status="KILLED")
            raise
        self._client.set_terminated(self._run)

    def record(self, kind: str, step: int, figures: Mapping[str, float]) -> None:
        from mlflow.entities import Metric

        # The step is the time as well: a repeated record is the same entry.
        metrics = [Metric(f"{kind}.{name}", value, step, step) for name, value in figures.items()]
        self._client.log_batch(self._run, metrics=metrics)
