"""Where training stands, in files: one safetensors file with a JSON header, replaced atomically, beside the replay buffer's.

The folder is named after all that decides the result: recipe, plant, forward model, versions of the libraries. Training that
differs in any of it does not find the folder; training that does not goes on to the bits it would have reached without a break.
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
from sysid.networks.checkpoint import REMEDY
from sysid.rl.ddpg import Trainer
from sysid.rl.recipe import TrainingRecipe
from sysid.root import Root

#: Of the files; another one is another name.
FORMAT = 1
STATE = "state.safetensors"
#: Libraries whose versions decide the bits.
LIBRARIES = ("torch", "numpy", "numba")


def training_folder(root: Path, recipe: TrainingRecipe, origin: Mapping[str, str]) -> Path:
    """Where the training of ``recipe`` on versions of these digests stands."""
    libraries = {name: importlib.metadata.version(name) for name in LIBRARIES}
    decided = {"format": FORMAT, "recipe": recipe.to_json(), "origin": dict(origin), "libraries": libraries}
    digest = hashlib.sha256(json.dumps(decided, sort_keys=True).encode()).hexdigest()
    name = f"{recipe.name}-seed{recipe.seed}-{digest[:12]}"
    return Root(root).path(name) if root.is_dir() else root / name


@dataclass
class TrainingFiles:
    """The files of training that is under way; they stay when it is interrupted.

    Args:
        folder: made when it is missing.
        every: seconds between two checkpoints.
    """

    folder: Path
    every: float = 20.0
    _last: float = field(default_factory=time.monotonic, repr=False)

    @property
    def is_due(self) -> bool:
        return time.monotonic() - self._last >= self.every

    def save(self, trainer: Trainer) -> None:
        """Keep where ``trainer`` stands.

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
        write_durably(self.folder / STATE, content, "checkpoint", REMEDY)  # with its name, so that older segments may go
        trainer.replay.prune(self.folder)
        self._last = time.monotonic()

    def load(self, trainer: Trainer) -> bool:
        """Bring ``trainer`` to where it was saved; False where nothing was.

        Raises:
            StoreError: files that are no checkpoint of it.
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
        """Training is done. The state goes first: without it what is left is no checkpoint."""
        (self.folder / STATE).unlink(missing_ok=True)
        shutil.rmtree(self.folder, ignore_errors=True)


def _split(value: Any, key: str, arrays: dict[str, np.ndarray[Any, Any]]) -> Any:
    """Take the arrays out of a nested state, by dotted key; the rest is JSON."""
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
