"""Checkpoints of a training: one safetensors file with a JSON header, replaced atomically, and the replay buffer's files.

The name of the folder is a digest of everything that decides the result: recipe, plant, forward model, library versions. A
training with the same digest continues to the same bits as without an interruption.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import StoreError
from sysid.files import write_durably
from sysid.networks.member import REMEDY
from sysid.root import Root
from sysid_rl.train.ddpg import Trainer
from sysid_rl.train.recipe import TrainingRecipe

#: Version of the file format; part of the folder's digest.
FORMAT = 1
STATE = "state.safetensors"
#: Libraries whose versions decide the bits of a result.
LIBRARIES = ("torch", "numpy", "numba")


def training_folder(root: Path, recipe: TrainingRecipe, origin: Mapping[str, str]) -> Path:
    """Folder of the training of ``recipe`` on model versions with the digests ``origin``."""
    libraries = {name: importlib.metadata.version(name) for name in LIBRARIES}
    decided = {"format": FORMAT, "recipe": recipe.to_json(), "origin": dict(origin), "libraries": libraries}
    digest = hashlib.sha256(json.dumps(decided, sort_keys=True).encode()).hexdigest()
    name = f"{recipe.name}-seed{recipe.seed}-{digest[:12]}"
    return Root(root).path(name) if root.is_dir() else root / name


@dataclass
class TrainingFiles:
    """The files of an unfinished training.

    Args:
        folder: created if it is missing.
        every: seconds between two checkpoints.
    """

    folder: Path
    every: float = 20.0
    _last: float = field(default_factory=time.monotonic, repr=False)

    @property
    def is_due(self) -> bool:
        return time.monotonic() - self._last >= self.every

    def save(self, trainer: Trainer) -> None:
        """Save the state of ``trainer``.

        Raises:
            SettingsError: a network holds NaN; the last checkpoint stays.
            StorageError: the disk is full or fails; the last checkpoint stays whole.
        """
        from safetensors.numpy import save

        trainer.check()
        trainer.replay.save(self.folder)
        arrays: dict[str, np.ndarray[Any, Any]] = {}
        rest = _split(trainer.state(), "", arrays)
        content = save(arrays, {"format": str(FORMAT), "state": json.dumps(rest)})
        write_durably(self.folder / STATE, content, "checkpoint", REMEDY)  # durable, so that older segments can be deleted
        trainer.replay.prune(self.folder)
        self._last = time.monotonic()

    def load(self, trainer: Trainer) -> bool:
        """Restore ``trainer``; False if there is no checkpoint.

        Raises:
            StoreError: the files are no checkpoint of it.
        """
        from safetensors import SafetensorError, safe_open

        path = self.folder / STATE
        if not path.exists():
            return False
        try:
            with safe_open(path, framework="numpy") as file:
                rest = json.loads(file.metadata()["state"])
                arrays = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (no mapping)
            state = _joined(rest, arrays)
            trainer.restore(state)
            trainer.replay.load(self.folder, int(state["rows"]))
        except (SafetensorError, KeyError, TypeError, ValueError, RuntimeError) as error:
            found = f"not readable ({type(error).__name__}: {error})"
            raise StoreError(f"checkpoint {path}", found, "what training wrote", "Delete its folder.") from None
        return True

    def remove(self) -> None:
        """Remove the files, the state first: without it the rest is no checkpoint."""
        (self.folder / STATE).unlink(missing_ok=True)
        shutil.rmtree(self.folder, ignore_errors=True)


def _split(value: Any, key: str, arrays: dict[str, np.ndarray[Any, Any]]) -> Any:
    """Move the arrays of a nested state into ``arrays``, by dotted key; the rest is JSON."""
    if isinstance(value, np.ndarray):
        arrays[key] = np.ascontiguousarray(value)
        return {"array": key}
    if isinstance(value, Mapping):
        return {"table": {name: _split(item, f"{key}.{name}" if key else name, arrays) for name, item in value.items()}}
    return {"value": value.item() if isinstance(value, np.generic) else value}


def _joined(value: Any, arrays: Mapping[str, np.ndarray[Any, Any]]) -> Any:
    ((kind, content),) = value.items()
    if kind == "array":
        return arrays[content]
    if kind == "table":
        return {name: _joined(item, arrays) for name, item in content.items()}
    return content
