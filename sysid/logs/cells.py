"""Cells of text → numbers, as loggers and spreadsheets of any country write them.

The decimal mark is a point or a comma. Thousands may be separated by the other mark, spaces or apostrophes, and digits and
signs may be those of any script. ``1.234`` is 1.234 with decimal points and 1234 with decimal commas: the mark of the file
decides, unless the column has more cells that only the other mark can read (``0.917``, ``12.5``). ``5-`` and ``(5)`` are −5, as
accounting software writes it. A cell that is no number is missing.
"""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.logs.limits import Budget
from sysid.logs.table import Table
from sysid.logs.topic_columns import GrowingArray
from sysid.units import is_unit, si_factor, split_header

#: Lists that are parsed at a time, and the longest unit in a cell.
_LISTS, _UNIT = 2**14, 12
#: Signs, marks and spaces of text → those of a number.
_SIGNS = {
    **dict.fromkeys("\u2212\u2012\u2013\ufe63\uff0d", "-"), "\ufe62": "+", "\uff0b": "+", "\uff0e": ".", "\u066b": ".",
    "\uff0c": ",", "\u066c": "'", "\u2019": "'", "\u02bc": "'", "\u200b": "",
}  # fmt: skip
_WORDS = {"true": 1.0, "false": 0.0}
_INFINITE = re.compile(r"[+-]?inf(inity)?", re.IGNORECASE)
_EXPONENT = r"(?:[eE][+-]?\d+)?"
_PLAIN = {
    ".": re.compile(rf"[+-]?(?:\d+\.?\d*|\.\d+){_EXPONENT}", re.ASCII),
    ",": re.compile(rf"[+-]?(?:\d+(?:,\d+)?|,\d+){_EXPONENT}", re.ASCII),
}
#: Decimal mark → a number with separated thousands.
_GROUPED = {
    mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}(?P<by>[{other} '])\d{{3}}(?:(?P=by)\d{{3}})*(?:{re.escape(mark)}\d+)?", re.ASCII)
    for mark, other in ((".", ","), (",", "."))
}
#: A negative number as accounting software writes it: in parentheses, or with the sign behind it.
_ACCOUNTING = re.compile(r"\s*(?:\(\s*(?P<inside>[\d.,][\d., ']*)\)|(?P<before>[\d.,][\d., ']*)-)\s*", re.ASCII)
#: Letters at the ends of such a cell, in any script, and of no other number.
_SIGN_AROUND = r"^\(|[^\w.,\s]$"
#: A number that both decimal marks can read, as two values.
TWO_READINGS = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}", re.ASCII)
#: Separators of thousands that are no mark.
_SPACED = r"\d[^\w.,:+-]\d"
#: A date with time in ISO 8601, or a time of the day.
_DATE, _DAY_TIME = r"\d{4}-\d\d-\d\d[T ]\d\d:?\d\d.*", r"\d{1,2}:\d\d:\d\d(?:[.,]\d+)?"
STAMP = re.compile(f"{_DATE}|{_DAY_TIME}")
#: Years whose stamps fit into 64 bits of nanoseconds.
_YEARS = (1678, 2261)
_LIST = re.compile(r"\[\s*([+-]?[.\d].*|nan.*|null.*|none.*)?\]", re.IGNORECASE)


def plain(text: str) -> str:
    """``text`` with ASCII digits, signs and spaces where it has those of another script; ``5-`` and ``(5)`` are ``-5``."""
    if not text.isascii():
        text = "".join(_SIGNS.get(c, " " if c.isspace() else str(unicodedata.decimal(c, c))) for c in text)
    negative = _ACCOUNTING.fullmatch(text)
    return f"-{negative['inside'] or negative['before']}" if negative is not None else text


def number_of(text: str, decimal: str) -> float | None:
    """The number that a cell states with this decimal mark; None for other text."""
    text = plain(text).strip()
    if _PLAIN[decimal].fullmatch(text):
        return float(text.replace(decimal, "."))
    if (grouped := _GROUPED[decimal].fullmatch(text)) is not None:
        return float(text.replace(grouped["by"], "").replace(decimal, "."))
    return float(text) if _INFINITE.fullmatch(text) else _WORDS.get(text.lower())


def is_value(cell: str, decimal: str) -> bool:
    """Whether a cell is a number, a truth value, a list of numbers or a stamp."""
    return number_of(cell, decimal) is not None or STAMP.fullmatch(cell) is not None or _LIST.fullmatch(cell) is not None


def _numbers(text: pd.Series, decimal: str) -> npt.NDArray[np.float64]:
    """The numbers of cells (n,) that are not empty; NaN for other text."""
    direct = text
    if decimal == ",":
        direct = text.str.replace(",", ".", regex=False).where(~text.str.contains(".", regex=False), "")
    numbers = pd.to_numeric(direct, errors="coerce").to_numpy(dtype=np.float64, copy=True)
    rest = np.flatnonzero(np.isnan(numbers))
    if len(rest):
        codes, unique = pd.factorize(text.iloc[rest])
        values = (number_of(str(cell), decimal) for cell in unique)
        numbers[rest] = np.array([np.nan if value is None else value for value in values])[codes]
    return numbers


@dataclass
class CellColumn:
    """One column of a text table while it is read.

    Args:
        header: its name, with its unit if it has one.
        where: it is named so in errors.
        decimal: decimal mark of the file; ``proven`` where other cells than this column's show it.
        expected: number of rows, where it is known.
        is_time: whole numbers keep 64 bits.
    """

    header: str
    where: str
    budget: Budget
    decimal: str
    proven: bool = True
    expected: int = 0
    is_time: bool = False
    rows: int = 0
    _filled: int = 0
    #: Decimal mark → number of cells that it reads, and the first cell that it does not read; the first of other kinds.
    _read: dict[str, int] = field(default_factory=lambda: {".": 0, ",": 0})
    _example: dict[str, str] = field(default_factory=dict)
    #: Number of cells with separators of thousands, and whether one would be decimals with the other mark (1.234).
    _thousands: int = 0
    _doubtful: bool = False
    #: Number of cells with the sign of a negative number around or behind it.
    _accounting: int = 0
    _numbers: GrowingArray = field(init=False)
    _others: GrowingArray | None = None
    _whole: GrowingArray | None = None
    _stamps: GrowingArray | None = None
    _stamp_kind: str = ""
    #: The unit in cells, and the numbers that have it.
    _unit: str = ""
    _united: GrowingArray | None = None
    #: Cells that are lists in chunks of only lists, the values of each element, and element → how many are no numbers.
    _listed: int = 0
    _elements: list[GrowingArray] = field(default_factory=list)
    _damaged: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._numbers = GrowingArray(np.nan, expected=self.expected)
        if self.is_time:
            self._whole = GrowingArray(0, np.dtype(np.int64), expected=self.expected)

    @property
    def _other(self) -> str:
        return "," if self.decimal == "." else "."

    def take(self, cells: pd.Series) -> None:
        """The next rows: numbers, or text with missing values."""
        first, self.rows = self.rows, self.rows + len(cells)
        if pd.api.types.is_numeric_dtype(cells):  # the parser of the table has read them with the mark of the file
            numbers = cells.to_numpy(dtype=np.float64)
            whole = cells.dtype.kind == "i" if isinstance(cells.dtype, np.dtype) else False
            self._keep_whole(first, cells.to_numpy() if whole else None)
            self._numbers.put(slice(first, self.rows), numbers)
            known = ~np.isnan(numbers)
            decimals = known & (numbers != np.rint(numbers))  # the other mark reads only whole numbers
            self._filled += int(np.count_nonzero(known))
            self._read[self.decimal] += int(np.count_nonzero(known))
            self._read[self._other] += int(np.count_nonzero(known & ~decimals))
            if decimals.any():
                self._example.setdefault(self._other, f"{numbers[decimals][0]:g}".replace(".", self.decimal))
            if self._others is not None:
                self._others.put(slice(first, self.rows), np.where(decimals, np.nan, numbers))
            return
        self._keep_whole(first, None)
        places = np.flatnonzero(cells.notna().to_numpy())
        self._filled += len(places)
        self._take_text(cells.iloc[places].astype("str").str.strip(), first, places)
        if len(places) and _are_lists(cells):
            self._listed += len(places)
            for begin in range(0, len(cells), _LISTS):
                self._take_lists(cells.iloc[begin : begin + _LISTS], first + begin)
        else:
            self._elements, self._damaged = [], {}  # a column with text is no column of lists

    def _keep_whole(self, first: int, values: npt.NDArray[np.int64] | None) -> None:
        if self._whole is not None and values is not None:
            self._whole.put(slice(first, self.rows), values)
        else:
            self._whole = None

    def _take_text(self, text: pd.Series, first: int, places: npt.NDArray[np.intp]) -> None:
        """Cells (n,) that are not empty, at ``places`` of a chunk that begins with row ``first``."""
        rows = first + places
        numbers, others = _numbers(text, self.decimal), _numbers(text, self._other)
        unread = np.isnan(numbers) & np.isnan(others)
        stamped, united = np.zeros(len(text), dtype=bool), np.zeros(len(text), dtype=bool)
        if unread.any():
            left = np.flatnonzero(unread)
            stamped[left] = self._take_stamps(text.iloc[left], rows[left])
            united[left] = self._take_united(text.iloc[left], rows[left])
        for mark, values in ((self.decimal, numbers), (self._other, others)):
            bad = np.isnan(values)
            self._read[mark] += len(values) - int(np.count_nonzero(bad))
            for kind, some in ((mark, bad & ~stamped & ~united), ("unit", united), ("stamp", stamped)):
                if kind not in self._example and some.any():
                    self._example[kind] = str(text.iloc[int(np.argmax(some))])
        decimals_too = np.abs(numbers) > np.abs(others)
        self._doubtful = self._doubtful or bool(decimals_too.any())
        thousands = decimals_too | (~np.isnan(numbers) & text.str.contains(_SPACED).to_numpy(dtype=bool))
        if thousands.any():
            self._thousands += int(np.count_nonzero(thousands))
            self._example.setdefault("thousands", str(text.iloc[int(np.argmax(thousands))]))
        self._count_accounting(text, ~unread)
        if self._others is None and not np.array_equal(numbers, others, equal_nan=True):  # until here both marks read the same
            before = self._numbers.whole(first)
            self._others = GrowingArray(np.nan, expected=self.expected)
            self._others.extend(np.where(before == np.rint(before), before, np.nan))
        self._numbers.put(rows, numbers)
        if self._others is not None:
            self._others.put(rows, others)

    def _count_accounting(self, text: pd.Series, known: npt.NDArray[np.bool_]) -> None:
        """Count the cells (n,) in the form of accounting, of those that are numbers."""
        signs = known & text.str.contains(_SIGN_AROUND).to_numpy(dtype=bool)
        if signs.any():
            self._accounting += int(np.count_nonzero(signs))
            self._example.setdefault("accounting", str(text.iloc[int(np.argmax(signs))]))

    def _take_stamps(self, text: pd.Series, rows: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
        """Keep the stamps among cells (n,) without a number; the mask of those cells."""
        found = np.zeros(len(text), dtype=bool)
        for kind, pattern in (("date", _DATE), ("day", _DAY_TIME)):
            places = np.flatnonzero(text.str.fullmatch(pattern).to_numpy(dtype=bool))
            if not len(places) or self._stamp_kind not in ("", kind):
                continue
            self._stamp_kind = kind
            if self._stamps is None:
                self._stamps = GrowingArray(np.iinfo(np.int64).min, np.dtype(np.int64), expected=self.expected)
            stamps = _nanoseconds(text.iloc[places].str.replace(",", ".", regex=False), kind)
            known = stamps != np.iinfo(np.int64).min
            self._stamps.put(rows[places[known]], stamps[known])
            found[places[known]] = True
        return found

    def _take_united(self, text: pd.Series, rows: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
        """Keep the numbers with a unit among cells (n,), the first frequent one (``0.12 rad``); the mask of those cells."""
        kept = np.zeros(len(text), dtype=bool)
        if not self._unit:
            parts = text.str.extract(rf"^(.*\d)\s*([^\d\s.,]\S{{0,{_UNIT - 1}}})$").dropna()
            for unit in parts[1].mode().head(1):
                number = str(parts[0][parts[1] == unit].iloc[0])
                if any(number_of(number, mark) is not None for mark in ".,") and is_unit(unit):
                    self._unit = unit
        if not self._unit:
            return kept
        places = np.flatnonzero(text.str.endswith(self._unit).to_numpy(dtype=bool))
        shorter = text.iloc[places].str.removesuffix(self._unit).str.rstrip()
        numbers = _numbers(shorter, self.decimal)
        numbers = np.where(np.isnan(numbers), _numbers(shorter, self._other), numbers)
        known = ~np.isnan(numbers)
        self._count_accounting(shorter, known)
        if known.any() and self._united is None:
            self._united = GrowingArray(np.nan, expected=self.expected)
        if self._united is not None:
            self._united.put(rows[places[known]], numbers[known])
            kept[places[known]] = True
        return kept

    def _take_lists(self, column: pd.Series, first: int) -> None:
        """The elements of lists; a shorter list leaves its last ones missing."""
        cells = column.astype("str").where(column.notna(), "[]").str.strip().str[1:-1]
        width = int(cells.str.count(",").max()) + 1
        self.budget.check_columns(self.where, width, "elements of a list")
        self.budget.check_numbers(self.where, width * (first + len(cells)))
        parts = cells.str.split(",", expand=True)
        self._elements += [GrowingArray(np.nan) for _ in range(width - len(self._elements))]
        for element in range(width):
            text = parts[element].str.strip().replace("", None)
            numbers = pd.to_numeric(text, errors="coerce").to_numpy(dtype=np.float64)
            bad = int(np.count_nonzero(np.isnan(numbers) & text.notna().to_numpy() & (text.str.lower() != "nan").to_numpy()))
            if bad:
                self._damaged[element] = self._damaged.get(element, 0) + bad
            self._elements[element].put(slice(first, first + len(numbers)), numbers)

    def table(self) -> Table:
        """The column, or the elements of its lists, and what was lost; a column without numbers is unread."""
        name, unit = split_header(self.header)
        if 0 < self._listed == self._filled:
            suffix = "" if unit is None else f" [{unit}]"
            elements = [(f"{name}[{i}]{suffix}", element.whole(self.rows)) for i, element in enumerate(self._elements)]
            damaged = sorted(self._damaged.items())
            return Table(elements, tuple(f"column {name}[{i}]: {n} elements are not numbers" for i, n in damaged))
        here, there = self._read[self.decimal], self._read[self._other]
        mark = self._other if there > here else self.decimal
        read = self._read[mark]
        if self._doubtful and here == there and not self.proven:
            doubt = "where no cell shows whether the mark is that of decimals (`decimal` in the recipe states it)"
            return Table(unread={name: f"numbers such as {self._example['thousands']!r}, {doubt}"})
        if self._stamps is not None and self._stamps.found > read:
            kind = "datetime64[ns]" if self._stamp_kind == "date" else "timedelta64[ns]"
            return Table([(self.header, self._stamps.whole(self.rows).view(kind))], self._lost(self._stamps.found, mark))
        header, numbers = self.header, self._numbers if mark == self.decimal or self._others is None else self._others
        united = self._united.found if self._united is not None else 0
        agree = read == 0 if unit is None else united > 0 and si_factor(unit) == si_factor(self._unit)
        if united and self._united is not None and agree:
            values = self._united.whole(self.rows)
            known = np.flatnonzero(~np.isnan(values))
            numbers.put(known, values[known])
            read += united
            header = header if unit is not None else f"{name} [{self._unit}]"
        elif united > read:
            other = f"and {read} without" if unit is None else f"below a header in [{unit}]"
            return Table(unread={name: f"{united} numbers with the unit [{self._unit}] {other}"})
        elif self._filled and not read:
            return Table(unread={name: f"text, for example {self._example[mark]!r}"})
        losses = list(self._lost(read, mark))
        if united and agree:
            losses.append(f"column {self.header!r}: {united} cells state the unit [{self._unit}]")
        marks = {".": "decimal points", ",": "decimal commas"}
        if mark != self.decimal:
            losses.append(f"column {self.header!r}: {marks[mark]}, while the file has {marks[self.decimal]}")
        elif self._thousands:
            example = self._example["thousands"]
            what = f"{self._thousands} cells with separators of thousands, {example!r} is {number_of(example, mark):g}"
            losses.append(f"column {self.header!r}: {what}")
        if self._accounting:
            example = self._example["accounting"]
            what = f"{self._accounting} cells with the sign of accounting, {example!r} is {number_of(example, mark):g}"
            losses.append(f"column {self.header!r}: {what}")
        if self._whole is not None:
            return Table([(header, self._whole.whole(self.rows))], tuple(losses))
        return Table([(header, numbers.whole(self.rows))], tuple(losses))

    def _lost(self, read: int, mark: str) -> tuple[str, ...]:
        count = self._filled - read
        if not count:
            return ()
        what = f"{count} cells are not numbers" if count > 1 else "1 cell is not a number"
        example = next(self._example[kind] for kind in (mark, "unit", "stamp") if kind in self._example)
        return (f"column {self.header!r}: {what}, for example {example!r}: taken as missing",)


def _nanoseconds(text: pd.Series, kind: str) -> npt.NDArray[np.int64]:
    """Dates with time (ISO 8601, UTC where no zone is given) since 1970, or times of the day [ns]; else the least number."""
    stamps: Any
    if kind == "day":
        stamps = pd.to_timedelta(text, errors="coerce")
    else:
        years = text.str.slice(0, 4).astype(int)
        stamps = pd.to_datetime(text.where(years.between(*_YEARS)), format="ISO8601", utc=True, errors="coerce")
    numbers: npt.NDArray[np.int64] = stamps.dt.as_unit("ns").astype(np.int64).to_numpy()
    return numbers


def _are_lists(column: pd.Series) -> bool:
    """Whether every cell that is not empty is a list in brackets."""
    cells = column.dropna().astype(str).str.strip()
    return len(cells) > 0 and bool((cells.str.startswith("[") & cells.str.endswith("]")).all())
