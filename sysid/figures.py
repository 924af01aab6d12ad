"""One description of each figure that is shown: its name, SI unit and digits, values before and after, interval, noise floor.

Console, report, site, cards and Rerun recording take the texts of a figure from here, so that no two of them can differ. A
:class:`Table` of them is rendered as text, as Markdown, and by the filter ``table`` of :mod:`sysid.reports.pages`.
"""

from __future__ import annotations

import itertools
import math
import re
import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from sysid.display import NOTHING, decimals_for, digits_for, fixed, interval, quantity, ratio, shown_unit
from sysid.foreign import visible
from sysid.quoting import markdown

#: Characters of one cell of a table.
MAX_CELL = 1000


@dataclass(frozen=True)
class Table:
    """Cells below a header; a cell may be markup, for pages.

    Args:
        right: numbers of the columns that are aligned right.
        title: heading above it.
        empty: text without any row.
        row_classes: number of a row → its class in the style sheet of a page.
    """

    header: tuple[str, ...] = ()
    rows: Sequence[Sequence[object]] = ()
    right: Collection[int] = ()
    title: str = ""
    empty: str = ""
    row_classes: Mapping[int, str] = field(default_factory=dict)

    def text(self, width: int) -> tuple[list[str], range]:
        """Lines for a terminal of a width in columns, and the numbers of those of the header.

        Cells are wrapped between words; where that is not enough for the width, every row is a list of its cells.
        """
        cells = [[visible(cell, MAX_CELL) for cell in row] for row in self.rows]
        fits = ((gap, _widths([self.header, *cells], width, gap)) for gap in (3, 2, 1))
        gap, widths = next(((gap, found) for gap, found in fits if found is not None), (0, None))
        if widths is None:
            return [*(line for row in cells for line in self._listed(row, width)), ""], range(0)
        wide = sum(widths) + gap * (len(widths) - 1)
        edge = " " * (wide + 2)
        head = list(_aligned(self.header, widths, self.right, gap))
        body = (line for row in cells for line in _aligned(row, widths, self.right, gap))
        return [edge, *head, f" {'─' * wide} ", *body, edge], range(1, 1 + len(head))

    def _listed(self, row: Sequence[str], width: int) -> Iterator[str]:
        """An empty line, and each cell of a row below its header."""
        yield ""
        for number, (name, cell) in enumerate(zip(self.header, row, strict=True)):
            if cell:
                label, indent = (f"{name}: " if name else ""), "  " if number else " "
                yield from textwrap.wrap(
                    f"{label}{cell}", width, break_long_words=False, break_on_hyphens=False,
                    initial_indent=indent, subsequent_indent=f"{indent}  ",
                )  # fmt: skip

    def markdown(self) -> str:
        """The table as Markdown."""
        lines = [self.header, tuple("---" for _ in self.header), *self.rows]
        return "\n".join("| " + " | ".join(markdown(str(cell)) for cell in line) + " |" for line in lines)


#: Where a cell may be broken: not in a pair such as ``3.2 / 4.1``.
BREAK = re.compile(r"(?<!/) (?!/)")


def _widths(rows: Sequence[Sequence[str]], width: int, gap: int) -> list[int] | None:
    """Widths of columns that take at most ``width`` together with gaps between them.

    No column is narrower than its longest word; None where that is too wide.
    """
    from rich.cells import cell_len

    columns = list(zip(*rows, strict=True))
    found, room = [max(map(cell_len, column)) for column in columns], width - gap * (len(columns) - 1) - 2
    if sum(found) <= room:  # always so for a table of many rows, whose words are not counted
        return found
    least = [max(cell_len(word) for cell in column for word in BREAK.split(cell)) for column in columns]
    while sum(found) > room:
        wide = [number for number in range(len(found)) if found[number] > least[number]]
        if not wide:
            return None
        found[max(wide, key=lambda number: found[number])] -= 1
    return found


def _wrapped(cell: str, width: int) -> list[str]:
    """The lines of a cell: words up to a width in columns of the terminal."""
    from rich.cells import cell_len

    if cell_len(cell) <= width:
        return [cell]
    lines = [""]
    for word in BREAK.split(cell):
        longer = f"{lines[-1]} {word}" if lines[-1] else word
        if cell_len(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def _aligned(row: Sequence[str], widths: Sequence[int], right: Collection[int], gap: int) -> Iterator[str]:
    """The lines of the cells side by side, padded to widths in columns of the terminal."""
    from rich.cells import cell_len

    for line in itertools.zip_longest(*map(_wrapped, row, widths), fillvalue=""):
        parts = []
        for number, (cell, width) in enumerate(zip(line, widths, strict=True)):
            space = " " * (width - cell_len(cell))
            parts.append(f"{space}{cell}" if number in right else f"{cell}{space}")
        yield f" {(' ' * gap).join(parts)} "


# -- errors of a simulation ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ErrorFigure:
    """Root mean square error of a signal, or of the position of a point, before and after the repair [SI]."""

    name: str
    unit: str
    before: float
    after: float
    noise_floor: float

    @property
    def closed(self) -> float:
        """(before − after) / (before − noise floor); NaN where the gap is within a twentieth of the noise floor."""
        closable = self.before - self.noise_floor
        return (self.before - self.after) / closable if closable > 0.05 * self.noise_floor else math.nan

    @property
    def texts(self) -> tuple[str, str, str]:
        """Before, after and noise floor, each with its unit."""
        return (quantity(self.before, self.unit), quantity(self.after, self.unit), quantity(self.noise_floor, self.unit))


def aligned(values: Sequence[float], unit: str) -> tuple[list[str], str]:
    """The values of a row with as many decimals as the smallest needs, and their unit."""
    factor, label = shown_unit(unit)
    decimals = decimals_for(factor * value for value in values)
    return [fixed(factor * value, decimals) for value in values], label


def times(error: float, noise_floor: float) -> str:
    """An error as a multiple of its noise floor."""
    return ratio(error / noise_floor if noise_floor > 0.0 else math.nan)


# -- parameters of effects ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ParameterFigure:
    """One parameter of an effect.

    Args:
        name: with ``[i]`` for a component of a vector.
        unit: SI unit; empty where it is not known.
        value: number, vector, word; None for a plant without the effect.
        interval95: its ends, vectors for a vector; None where it is not known.
        before: the value that it replaces; None without one.
    """

    name: str
    unit: str
    value: Any
    interval95: tuple[Any, Any] | None = None
    before: Any = None

    @property
    def label(self) -> str:
        return self.name.replace("_", " ")

    @property
    def digits(self) -> int:
        """At which the ends of the interval differ."""
        return max((digits_for(*ends) for ends in self._ends), default=3)

    @property
    def text(self) -> str:
        """The value with its unit, in the digits of its interval."""
        return value_text(self.value, self.unit, self.digits)

    @property
    def before_text(self) -> str:
        return value_text(self.before, self.unit)

    @property
    def interval(self) -> str:
        """The interval, of a vector component by component; :data:`~sysid.display.NOTHING` where it is not known."""
        texts = [interval(low, high, self.unit) if math.isfinite(high - low) else NOTHING for low, high in self._ends]
        return ", ".join(texts) if {*texts} - {NOTHING} else NOTHING

    @property
    def sentence(self) -> str:
        """``time constant 170 ms (165 to 175 ms)``."""
        ends = self.interval
        return f"{self.label} {self.text}" + (f" ({ends})" if ends != NOTHING else "")

    @property
    def _ends(self) -> list[tuple[float, float]]:
        low, high = self.interval95 or (None, None)
        if isinstance(low, list | tuple) and isinstance(high, list | tuple):
            return [(float(a), float(b)) for a, b in zip(low, high, strict=True)]
        return [(float(low), float(high))] if isinstance(low, float | int) and isinstance(high, float | int) else []


def value_text(value: Any, unit: str, digits: int = 3) -> str:
    """A value with its unit; vectors component by component, words as they are."""
    if isinstance(value, list | tuple):
        return "(" + ", ".join(value_text(item, unit, digits) for item in value) + ")"
    return quantity(float(value), unit, digits) if isinstance(value, float | int) else "none" if value is None else str(value)


def stored_parameters(effect: Mapping[str, Any]) -> list[ParameterFigure]:
    """Those of an effect in the JSON of a gap result or in a lineage, without the undetermined ones."""
    units, intervals = effect.get("units") or {}, effect.get("interval95") or {}
    return [
        ParameterFigure(name, str(units.get(name, "")), value, tuple(intervals.get(name) or ()) or None)
        for name, value in effect.get("parameters", {}).items()
        if value is not None
    ]


# -- errors of networks -------------------------------------------------------------------------------------------------


class HasRows(Protocol):
    """An output of a network on rows of one kind."""

    @property
    def output(self) -> str: ...

    @property
    def rows(self) -> str: ...


@dataclass(frozen=True)
class NetworkError:
    """Held-out errors of one output of a network [SI].

    Args:
        rows: ``motion`` or ``poses``.
        noise_floor: error by sensor noise alone; None where it is not known.
        baselines: simple model → its RMSE on the same rows.
    """

    output: str
    rows: str
    unit: str
    rmse: float = math.nan
    p95: float = math.nan
    max: float = math.nan
    noise_floor: float | None = None
    baselines: Mapping[str, float] = field(default_factory=dict)

    @property
    def best_simple(self) -> str:
        """The simple model with the smallest error; empty without any."""
        return min(self.baselines, key=lambda name: self.baselines[name], default="")

    @property
    def texts(self) -> tuple[str, str, str]:
        """RMSE, 95 % and maximum, each with its unit."""
        return quantity(self.rmse, self.unit), quantity(self.p95, self.unit), quantity(self.max, self.unit)


def stored_errors(metrics: Mapping[str, float]) -> list[NetworkError]:
    """RMSE, 95 % and maximum of every output, from the figures that are stored with a version of a network."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for key, value in metrics.items():
        output, _, figure = key.rpartition(".")
        signal, rows = output_of(output)
        if figure in ("rmse", "p95", "max") and signal:
            found.setdefault((signal, rows), {})[figure] = value
    return [NetworkError(signal, rows, output_unit(signal), **own) for (signal, rows), own in found.items()]


#: Kind of rows → words.
ROWS = {"motion": "in motion", "poses": "at poses"}


def output_name(entry: HasRows) -> str:
    """``boom.joint in motion``."""
    return f"{entry.output} {ROWS[entry.rows]}"


def output_of(key: str) -> tuple[str, str]:
    """Signal and kind of rows of a stored figure: ``boom.joint.motion``."""
    signal, _, rows = key.rpartition(".")
    return signal, "poses" if rows == "poses" else "motion"


def output_unit(signal: str) -> str:
    """SI unit of an output of a network."""
    return "rad" if signal.endswith(".joint") else "m"
