"""Cases of a row with their seeds, written to a folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from arms import arm, flexible, poses, servo_arm, servo_sag, smooth_friction
from arms.case import Case, write_case

#: Generators in the order of the table; each has ``NAME`` and ``cases(seed)``.
ROWS = {module.NAME: module for module in (arm, servo_arm, servo_sag, poses, flexible, smooth_friction)}


def cases_of(row: str, seed: int) -> Iterator[Case]:
    """The cases of one seed of a row."""
    yield from ROWS[row].cases(seed)


def generate(rows: Sequence[str], seeds: Sequence[int], work: Path) -> list[Path]:
    """Write the cases; returns their folders ``<work>/<row>/<case>``."""
    found = []
    for row in rows:
        for seed in seeds:
            for case in cases_of(row, seed):
                folder = work / row / case.name
                write_case(case, folder)
                found.append(folder)
    return found
