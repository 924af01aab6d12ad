"""The published result: each row keeps the cases of its own last publication, with seeds, commit, versions and date."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from arms.generate import ROWS
from committed import CHANGED

#: Seeds that are published, in the order in which a row takes them, and how many of them a row has at least.
PUBLISHED, LEAST = range(120, 180), 10
#: What a row keeps of the provenance of its run.
KEPT = ("command", "versions", "machine", "date")


def result_of(
    rows: Sequence[str],
    seeds: Sequence[int],
    cases: Sequence[Mapping[str, Any]],
    commits: Mapping[str, Sequence[str]],
    head: Mapping[str, Any],
) -> dict[str, Any]:
    """The contents of a result file.

    Args:
        commits: row → commits whose code answered its cases.
        head: of :func:`committed.provenance`.
    """
    own = {row: {"seeds": list(seeds), "commits": list(commits[row]), **{key: head[key] for key in KEPT}} for row in rows}
    return {**head, "rows": own, "cases": list(cases)}


def merged(earlier: Mapping[str, Any] | None, fresh: Mapping[str, Any]) -> dict[str, Any]:
    """``fresh`` with those rows of ``earlier`` that it does not have, in the order of the table."""
    parts = [fresh] if earlier is None else [earlier, fresh]
    source = {row: part for part in parts for row in part["rows"]}
    there = [row for row in ROWS if row in source]
    rows = {row: source[row]["rows"][row] for row in there}
    cases = [case for row in there for case in source[row]["cases"] if case["row"] == row]
    return {**fresh, "rows": rows, "cases": cases}


def check_published(seeds: Sequence[int], commits: Mapping[str, Sequence[str]]) -> None:
    """Whether a run may be published.

    Raises:
        ValueError: seeds that were chosen, or answers of code that no commit holds.
    """
    if len(seeds) < LEAST or list(seeds) != list(PUBLISHED[: len(seeds)]):
        first, least, last = PUBLISHED[0], PUBLISHED[LEAST - 1], PUBLISHED[-1]
        raise ValueError(f"--publish: expected --seeds {first}:LAST, LAST from {least} to {last}, the published ones")
    for row, own in commits.items():
        wrong = [commit for commit in own if commit.endswith(CHANGED)]
        if wrong or not own:
            found = f"of commit {wrong[0]}" if wrong else "without a commit"
            raise ValueError(
                f"--publish: row {row!r} has answers {found}; expected answers of code that is committed. "
                "Commit, and run the row in a new folder."
            )
