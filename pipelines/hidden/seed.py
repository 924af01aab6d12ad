"""The seed of a calibration: that of the commit, which cannot be chosen, or a given one for development runs.

Published figures are those of seed = int(first eight hex digits of the commit, 16): the cases follow from the commit with the
search, so that the search cannot be tuned to them.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

#: Hex digits of the commit that are the seed.
DIGITS = 8
#: Files that a calibration writes; a tree that differs in these only counts as unchanged.
RESULT_FILES = ("reports/hidden_effects/",)


@dataclass(frozen=True)
class Seed:
    """``value`` draws the cases; ``commit`` is the one it comes from, None for a development run."""

    value: int
    commit: str | None = None

    @property
    def published(self) -> bool:
        """Whether the run may write the committed result."""
        return self.commit is not None


def seed_of(given: str, root: Path) -> Seed:
    """``"commit"``: the seed of HEAD, on a clean tree; otherwise the number that is given.

    Raises:
        ValueError: no number, or a tree that is not that of its commit.
    """
    if given != "commit":
        if not given.isdigit():
            raise ValueError(f"--seed: {given!r} is no seed; expected a whole number ≥ 0, or 'commit'.")
        return Seed(int(given))
    changed = changes(root)
    if changed:
        listed = ", ".join(changed[:3]) + (f" and {len(changed) - 3} more" if len(changed) > 3 else "")
        raise ValueError(
            f"{root}: the tree differs from its commit in {listed}; expected no change beside the result files, since the seed "
            "is that of the commit. Commit the changes, or give --seed N for a development run."
        )
    return seed_of_commit(_git(root, "rev-parse", "HEAD").strip())


def seed_of_commit(commit: str) -> Seed:
    """The seed that belongs to a full commit hash."""
    return Seed(int(commit[:DIGITS], 16), commit)


def changes(root: Path) -> list[str]:
    """Paths in which the tree differs from HEAD, new ones too, without the result files."""
    lines = _git(root, "status", "--porcelain", "--untracked-files=all").splitlines()
    return [path for path in (line[3:] for line in lines) if not path.startswith(RESULT_FILES)]


def check_unchanged(seed: Seed, root: Path) -> None:
    """Check, before a result is written, that the tree is still that of the seed's commit.

    Raises:
        ValueError: HEAD or files have changed since the run began.
    """
    if seed.commit is not None and seed_of("commit", root) != seed:
        raise ValueError(
            f"{root}: HEAD is not {seed.commit} any more; expected the commit that the run began with. Check it out."
        )


def check_same_seed(seed: Seed, result: Path) -> None:
    """Check that a run can continue from a result file.

    Raises:
        ValueError: it is of another seed.
    """
    if not result.exists():
        return
    found = json.loads(result.read_text("utf-8"))
    if found["seed"] != seed.value:
        raise ValueError(
            f"{result}: seed {found['seed']}; expected {seed.value}, since cases of another seed are other cases. Run without "
            "--resume, or check out the commit of that result."
        )


def _git(root: Path, *arguments: str) -> str:
    command: Sequence[str] = ("git", "-C", str(root), *arguments)
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout
