"""Effects × targets in ``docs/guide/export.md``, from the code: ``python pipelines/export_matrix.py docs/guide/export.md``."""

from __future__ import annotations

import sys
from pathlib import Path

from sysid.effects import CATALOGUE
from sysid.export.export import TARGETS
from sysid.export.target import Target

BEGIN = "<!-- Written by python pipelines/export_matrix.py docs/guide/export.md: change the code instead. -->\n"
END = "<!-- end -->\n"
_MARKS = {"native": "native", "composed": "composed", "plugin": "plugin", "not_representable": "–"}


def matrix() -> str:
    """The table as Markdown: one column for targets that represent all effects alike, one row for effects represented alike."""
    columns: dict[tuple[str, ...], list[Target]] = {}
    for target in TARGETS:
        columns.setdefault(tuple(_MARKS[target.support(effect).kind] for effect in CATALOGUE), []).append(target)
    rows: dict[tuple[str, ...], list[str]] = {}
    for effect, *cells in zip(CATALOGUE, *columns, strict=True):
        rows.setdefault(tuple(cells), []).append(f"[`{effect.name}`](../effects/{effect.name}.md)")
    head = [", ".join(f"`{target.name}`" for target in group) for group in columns.values()]
    lines = [f"| {', '.join(names)} | {' | '.join(cells)} |" for cells, names in rows.items()]
    return "\n".join([f"| effects | {' | '.join(head)} |", "| --- |" + " --- |" * len(head), *lines, ""])


def with_matrix(page: str) -> str:
    """``page`` with the table between its marks."""
    before, _, rest = page.partition(BEGIN)
    return before + BEGIN + matrix() + END + rest.partition(END)[2]


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(with_matrix(path.read_text("utf-8")), "utf-8")
