"""Blocks of a card, and the card as Markdown (as HTML: :mod:`sysid.reports.model_pages`)."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.quoting import markdown
from sysid.validate import ErrorMap


@dataclass(frozen=True)
class CardBlock:
    """One section of a card: paragraphs, a table, code, error maps (output, unit, map); any of them may be empty."""

    title: str
    text: tuple[str, ...] = ()
    header: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    code: str = ""
    maps: tuple[tuple[str, str, ErrorMap], ...] = ()


@dataclass(frozen=True)
class Card:
    """A card; ``facts`` is the line under its title."""

    title: str
    facts: str
    blocks: tuple[CardBlock, ...]

    def markdown(self) -> str:
        """The card as Markdown."""
        parts = [f"# {self.title}", self.facts]
        for block in self.blocks:
            parts += [f"## {block.title}", *block.text]
            if block.rows:
                lines = [block.header, tuple("---" for _ in block.header), *block.rows]
                parts.append("\n".join("| " + " | ".join(markdown(cell) for cell in line) + " |" for line in lines))
            if block.code:
                parts.append(f"```python\n{block.code}\n```")
        return "\n\n".join(parts) + "\n"
