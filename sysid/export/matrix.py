"""``docs/export.md`` from the code: effects × targets. ``python -m sysid.export.matrix docs/export.md``."""

from __future__ import annotations

import sys
from pathlib import Path

from sysid.effects import CATALOGUE
from sysid.export.export import TARGETS
from sysid.export.page import KINDS
from sysid.export.target import Target

_NOTICE = "<!-- Written by python -m sysid.export.matrix docs/export.md: change the code instead. -->\n"
_INTRODUCTION = """# Export targets

This page lists how each target of [`sysid export`](guide/export.md) represents each [effect](effects/README.md):

| word | meaning |
| --- | --- |
| native | the format has it |
| composed | of several elements of the format |
| by plugin | by the drive model that ships with the export: `drive_model.py`, which needs NumPy alone, or TorchScript |
| not representable | the export lacks it; the replay shows what that costs |
"""


def matrix_page() -> str:
    """The page as Markdown."""
    names = [target.name for target in TARGETS]
    rows = [f"| effect | {' | '.join(f'`{name}`' for name in names)} |", "| --- |" + " --- |" * len(names)]
    for effect in CATALOGUE:
        cells = [KINDS[target.support(effect).kind] for target in TARGETS]
        rows.append(f"| [`{effect.name}`](effects/{effect.name}.md) | {' | '.join(cells)} |")
    return "\n".join([_NOTICE, _INTRODUCTION, *rows, "", *(line for target in TARGETS for line in _details(target))])


def _details(target: Target) -> list[str]:
    rows = ["| effect | | how |", "| --- | --- | --- |"]
    for effect in CATALOGUE:
        support = target.support(effect)
        rows.append(f"| `{effect.name}` | {KINDS[support.kind]} | {support.how} |")
    return [f"## `{target.name}`: {target.title}\n", *rows, ""]


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(matrix_page(), "utf-8")
