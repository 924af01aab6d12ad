"""The replay buffer: the newest transitions in one table, and their files.

The files are append-only segments: newer rows never change those of the last checkpoint, even if the process is killed while it
writes. Segments older than the buffer are deleted.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sysid.errors import StorageError, StoreError
from sysid.files import make_folder, on_disk

if TYPE_CHECKING:
    import torch

Array = npt.NDArray[np.float64]

#: Transitions in a file.
SEGMENT = 65_536


class Replay:
    """Rows ``observation | action | reward | next observation`` in float32.

    Args:
        capacity: rows kept; the oldest are overwritten.
        observations, actions: widths O and A; a row has 2·O + A + 1 columns.
        device: of the table.
    """

    def __init__(self, capacity: int, observations: int, actions: int, device: torch.device | str = "cpu") -> None:
        import torch

        self.capacity, self.width = capacity, 2 * observations + actions + 1
        self.rows = torch.zeros((capacity, self.width), device=device)
        #: Rows added since the beginning, and those of them that are in files.
        self.count, self.saved = 0, 0
        ends = np.cumsum([observations, actions, 1, observations])
        self.columns = [
            slice(end - width, end) for end, width in zip(ends, (observations, actions, 1, observations), strict=True)
        ]

    def __len__(self) -> int:
        return min(self.count, self.capacity)

    def add(self, observations: Array, actions: Array, rewards: Array, following: Array) -> None:
        """Transitions of n copies, (n, O), (n, A), (n,), (n, O); n may not be above the capacity."""
        import torch

        fresh = np.concatenate([observations, actions, rewards[:, None], following], axis=1, dtype=np.float32)
        at = self.count % self.capacity
        first = min(len(fresh), self.capacity - at)
        table = torch.from_numpy(fresh)
        self.rows[at : at + first] = table[:first].to(self.rows.device)
        if first < len(fresh):
            self.rows[: len(fresh) - first] = table[first:].to(self.rows.device)
        self.count += len(fresh)

    def draw(self, count: int, rng: np.random.Generator) -> torch.Tensor:
        """Numbers of ``count`` random rows, (count,), drawn with replacement, on the CPU."""
        import torch

        return torch.from_numpy(rng.integers(0, len(self), count))

    def take(self, chosen: torch.Tensor, out: torch.Tensor) -> torch.Tensor:
        """The rows of these numbers, (n,) on the device of the table, in ``out`` (n, width)."""
        import torch

        return torch.index_select(self.rows, 0, chosen, out=out)

    def save(self, folder: Path) -> None:
        """Write the rows that are not in files yet.

        Raises:
            StorageError: the disk is full or fails; the rows of the last checkpoint stay.
        """
        begin = max(self.saved, self.count - self.capacity)
        try:
            make_folder(folder)
            while begin < self.count:
                end = min(self.count, (begin // SEGMENT + 1) * SEGMENT)
                self._write(_segment(folder, begin), begin, end)
                begin = end
            on_disk(folder)  # the names of new files, before a checkpoint refers to them
        except OSError as error:
            raise StorageError(
                f"replay buffer in {folder}", error.strerror or str(error), f"room for {self.count - self.saved} transitions",
                "Make room; training goes on from the last checkpoint that was written.",
            ) from error  # fmt: skip
        self.saved = self.count

    def prune(self, folder: Path) -> None:
        """Delete segments older than the buffer. To be called after the new checkpoint is durable, name included: a power cut
        could otherwise restore the previous one, which needs them."""
        for path in folder.glob("replay-*.f32"):
            if (int(path.stem.partition("-")[2]) + 1) * SEGMENT <= self.count - self.capacity:
                path.unlink()

    def load(self, folder: Path, count: int) -> None:
        """Restore the buffer after its first ``count`` rows.

        Raises:
            StoreError: files that are missing or too short.
        """
        import torch

        begin = max(0, count - self.capacity)
        while begin < count:
            end = min(count, (begin // SEGMENT + 1) * SEGMENT)
            path = _segment(folder, begin)
            content = self._read(path, begin, end)
            at = np.arange(begin, end) % self.capacity
            self.rows[torch.from_numpy(at).to(self.rows.device)] = torch.from_numpy(content).to(self.rows.device)
            begin = end
        self.count = self.saved = count

    def _write(self, path: Path, begin: int, end: int) -> None:
        import torch

        at = np.arange(begin, end) % self.capacity
        content = self.rows[torch.from_numpy(at).to(self.rows.device)].cpu().numpy().tobytes()
        with open(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644), "r+b") as file:
            file.seek((begin % SEGMENT) * 4 * self.width)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())

    def _read(self, path: Path, begin: int, end: int) -> npt.NDArray[np.float32]:
        need: Any = (end - begin) * 4 * self.width
        try:
            with path.open("rb") as file:
                file.seek((begin % SEGMENT) * 4 * self.width)
                content = file.read(need)
        except FileNotFoundError:
            content = b""
        if len(content) < need:
            found = f"{len(content)} bytes from row {begin}"
            raise StoreError(f"replay buffer {path}", found, f"{need}", "Delete the folder; training starts again.")
        return np.frombuffer(content, dtype="<f4").reshape(-1, self.width).copy()


def _segment(folder: Path, row: int) -> Path:
    return folder / f"replay-{row // SEGMENT:06d}.f32"
