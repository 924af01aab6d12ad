"""Log folders to which recordings are added: the recordings that are complete and not in the dataset yet are appended.

A recording is complete if its MCAP file has its end, or if none of its files has changed for a while: the log of a runner that
was killed has no end, and is synced every second while it is written.
"""

from __future__ import annotations

import os
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from sysid.datasets import append
from sysid.errors import InputError
from sysid.progress import Progress, silent

#: A log without an end is complete if nothing was written to it for so long [s].
QUIET_S = 60.0
#: The last bytes of a complete MCAP file (mcap.dev/spec).
_END = b"\x89MCAP0\r\n"


@dataclass(frozen=True)
class Arrivals:
    """What a look at log folders found.

    Args:
        added: recordings that were appended. waiting: recordings that are still being written.
        left_out: (recording, why) of those that ingest refuses; they are read again by the next call.
    """

    added: tuple[str, ...] = ()
    waiting: tuple[str, ...] = ()
    left_out: tuple[tuple[str, str], ...] = ()


def take_in(
    folders: Sequence[Path], workspace: str, name: str, held: Collection[str], quiet_s: float, progress: Progress = silent
) -> Arrivals:
    """Append the complete recordings in ``folders`` that are not ``held`` to dataset ``name``, one version for all a folder.

    If one of them cannot be ingested, each is appended alone, so that it does not hold up the others.

    Raises:
        InputError: a folder is missing.
        SettingsError: another machine, or a mistake in the recipe.
    """
    added: list[str] = []
    waiting: list[str] = []
    left_out: list[tuple[str, str]] = []
    for folder in folders:
        if not folder.is_dir():
            raise InputError(folder, "no such folder", "the log folder of a runner", "Check the path.")
        complete: list[Path] = []
        for recording in sorted(folder.iterdir()):
            if recording.is_dir() and not recording.name.startswith(".") and recording.name not in held:
                if is_complete(recording, quiet_s):
                    complete.append(recording)
                else:
                    waiting.append(recording.name)
        taken, refused = _appended(complete, workspace, name, progress)
        added += taken
        left_out += refused
    return Arrivals(tuple(added), tuple(waiting), tuple(left_out))


def is_complete(recording: Path, quiet_s: float, now: float | None = None) -> bool:
    """Whether the files of a recording are written.

    Args:
        now: seconds since the epoch, by default the present time.
    """
    files = [path for path in recording.iterdir() if path.is_file()]
    if not files:
        return False
    if all(path.suffix == ".mcap" and _ends(path) for path in files):
        return True
    return (time.time() if now is None else now) - max(path.stat().st_mtime for path in files) >= quiet_s


def _ends(path: Path) -> bool:
    """Whether an MCAP file has its end."""
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size <= len(_END):
            return False
        file.seek(-len(_END), os.SEEK_END)
        return file.read() == _END


def _appended(
    recordings: Sequence[Path], workspace: str, name: str, progress: Progress
) -> tuple[list[str], list[tuple[str, str]]]:
    """The names of the recordings that were appended, and those that were not with the reason."""
    if not recordings:
        return [], []
    try:
        append(list(recordings), workspace, name, recipe=_recipe(recordings[0]), progress=progress)
    except InputError as error:
        if len(recordings) == 1:
            return [], [(recordings[0].name, str(error))]
        added: list[str] = []
        left_out: list[tuple[str, str]] = []
        for recording in recordings:
            own, refused = _appended([recording], workspace, name, progress)
            added += own
            left_out += refused
        return added, left_out
    return [recording.name for recording in recordings], []


def _recipe(recording: Path) -> Path | None:
    """The recipe beside a recording: the runner writes one for its logs."""
    path = recording.parent / "recipe.toml"
    return path if path.exists() else None
