"""The form of a text table: encoding, delimiter, decimal mark, and the lines of header, units and first row.

:class:`csv.Sniffer` decides by the frequency of letters and takes a decimal comma or a letter for the delimiter. Here the
rows are split with each combination of delimiter and decimal mark; the one is taken that gives rows of equal length full of
numbers.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import dropwhile
from pathlib import Path

from sysid.errors import InputError
from sysid.logs.cells import TWO_READINGS, is_value, plain
from sysid.logs.limits import MAX_LINE, Budget
from sysid.logs.reader import ReadOptions
from sysid.units import is_unit, split_header

#: Delimiter (a space: any white space) and decimal mark that are tried; of equally good ones the first is taken.
_FORMS = (
    (",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", "."), ("|", ","), (",", ","), (" ", "."), (" ", ","),
)  # fmt: skip
DELIMITERS = tuple(dict.fromkeys(delimiter for delimiter, _ in _FORMS))
#: Begin of a line that is a remark.
REMARKS = ("#", "%", "//")
#: Lines and letters from which the form is found.
_LINES, _LETTERS = 200, 2**18
#: Bytes from which the encoding is found.
_HEAD = 2**16
_ORDER_MARKS = ((b"\xef\xbb\xbf", "utf-8"), (b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be"))
_MARKS = {".": ",", ",": "."}
_NAMES = {",": "','", ";": "';'", "\t": "tab", "|": "'|'", " ": "white space"}
#: Cells without a value.
_MISSING = frozenset({"", "-", "--", "na", "n/a", "#n/a", "nan", "none", "null", "-nan", "#div/0!"})
_TYPES = frozenset(
    {"float", "double", "single", "int", "float32", "float64", "int16", "int32", "int64", "uint8", "bool", "string"}
)
_WHAT = "a CSV file with one header row"


@dataclass(frozen=True)
class Dialect:
    """The form of a text table.

    Args:
        delimiter: between cells; a space stands for any white space.
        decimal: mark before the decimals, ``.`` or ``,``; ``proven``: stated, or shown by the first rows.
        headers: names of the columns, with units (``boom.cylinder [mm]``) where a row of units states them.
        width: cells in most rows; ``len(headers)`` in a file without faults.
        header_line: number of the line of the header, from 1; 0: the file has none.
        named: whether ``headers`` are names of the file or of the recipe, not numbers of columns.
        offset, lines: bytes and lines before the first row of numbers.
        longest_remark: cells of the longest remark between the rows, as a parser splits it.
        cells: the header as it is in the file.
        remarks: sentences on what differs from a table with commas, points and one header row.
    """

    encoding: str
    delimiter: str
    decimal: str
    headers: tuple[str, ...]
    width: int
    header_line: int
    named: bool
    offset: int
    lines: int
    longest_remark: int = 0
    cells: tuple[str, ...] = ()
    first_row: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    proven: bool = True

    @property
    def separator(self) -> str:
        """The argument ``sep`` of :func:`pandas.read_csv`."""
        return r"\s+" if self.delimiter == " " else self.delimiter

    def check_named(self, path: Path) -> None:
        """Raise InputError where the file has no header row and the recipe does not name the columns."""
        if not self.named:
            numbers = ", ".join(self.first_row[:4]) + (" …" if len(self.first_row) > 4 else "")
            raise InputError(
                f"{path}: line {self.lines + 1}",
                f"no header row above the numbers {numbers}",
                f"names of the {self.width} columns",
                'Name them in the recipe: `columns = ["time", …]`; sysid ingest --inspect drafts the line.',
            )


@dataclass(frozen=True)
class _Line:
    number: int
    text: str
    start: int

    @property
    def is_remark(self) -> bool:
        return self.text.lstrip().startswith(REMARKS)


@dataclass(frozen=True)
class _Row:
    line: _Line
    cells: tuple[str, ...]


def find_dialect(path: Path, options: ReadOptions, budget: Budget) -> Dialect:
    """The form of the text table ``path``; what the recipe states (``options``) is taken as it is.

    Raises:
        InputError: not text, no line, a line or a number of columns beyond the limits.
    """
    encoding, start = _encoding(path)
    lines = _first_lines(path, encoding, start)
    table = [line for line in lines if not line.is_remark]
    stated = _stated_delimiter(table)
    if stated is not None:
        table = table[1:]
    if not table:
        raise InputError(path, "no header row", _WHAT, "Export the log again.")
    forms = [
        (delimiter, decimal)
        for delimiter, decimal in _FORMS
        if delimiter == (options.delimiter or stated or delimiter) and decimal == (options.decimal or decimal)
    ] or [(options.delimiter or stated or ",", options.decimal or ".")]
    found = max((_Split.of(table, *form) for form in forms), key=lambda split: split.score)
    if options.decimal is None:
        found = _with_decimal(path, found)
    budget.check_columns(path, max(len(row.cells) for row in found.rows))
    return _dialect(encoding, found, [line for line in lines if line.is_remark], options)


def _with_decimal(path: Path, split: _Split) -> _Split:
    """``split`` with the decimal mark of its cells, also where all of them can be read in two ways (1,234).

    A point then is the decimal mark, and so is a comma beside the delimiter ``;``, which spreadsheets write where the comma is.

    Raises:
        InputError: a column has 1,234 or 1.234 beside 999, or commas, and nothing shows which mark it is.
    """
    other = replace(split, decimal="," if split.decimal == "." else ".")
    if other.score != split.score:
        return split
    columns: dict[int, list[str]] = {}
    for row in split.rows:
        for column, cell in enumerate(row.cells):
            columns.setdefault(column, []).append(plain(cell))
    two = {column: [match for cell in cells if (match := TWO_READINGS.fullmatch(cell))] for column, cells in columns.items()}
    marks = {match[1] for matches in two.values() for match in matches}
    if not marks:
        return replace(split, proven=False)
    decimal = "," if split.delimiter == ";" and "," in marks else "."
    for column, matches in two.items():
        short = next((cell for cell in columns[column] if re.fullmatch(r"[+-]?\d{1,3}", cell)), None)
        mixed = short is not None and split.delimiter == ";"
        mark = matches[0][1] if matches else decimal
        if (mixed and matches) or mark != decimal:
            value = matches[0][0] + (f" beside {short}" if mixed else "")
            found = f"numbers such as {value}, and no cell that shows whether {mark!r} is the decimal mark"
            remedy = f'State `decimal = "{mark}"` in the recipe if it is, else `decimal = "{_MARKS[mark]}"`; or export without '
            raise InputError(f"{path}: column {column + 1}", found, "one way to read them", remedy + "separators of thousands.")
    return replace(split, decimal=decimal)


@dataclass(frozen=True)
class _Split:
    """The rows of a table, split with one delimiter."""

    delimiter: str
    decimal: str
    rows: tuple[_Row, ...]
    proven: bool = True

    @classmethod
    def of(cls, lines: Sequence[_Line], delimiter: str, decimal: str) -> _Split:
        return cls(delimiter, decimal, tuple(_Row(line, cells_of(line.text, delimiter)) for line in lines))

    @cached_property
    def width(self) -> int:
        """Cells in most rows; rows of numbers count, where there are any."""
        rows = [row for row in self.rows if any(_kind(cell, self.decimal) == 1 for cell in row.cells)] or self.rows
        counts = Counter(len(row.cells) for row in rows)
        most = max(counts, key=lambda count: (counts[count], count))
        return min(most, max(_filled(row.cells) for row in self.rows))  # delimiters at the end of every line

    @cached_property
    def score(self) -> float:
        """Share of rows of equal length, weighted with the share of numbers among the cells below the header."""
        if max(len(row.cells) for row in self.rows) < 2:
            return 0.0
        equal = max(Counter(len(row.cells) for row in self.rows).values()) / len(self.rows)
        rows = [[_kind(cell, self.decimal) for cell in row.cells] for row in self.rows]
        kinds = Counter(kind for row in dropwhile(lambda row: 1 not in row, rows) for kind in row)
        return equal * (0.05 + kinds[1] / max(1, kinds[1] + kinds[2])) * (1.0 if self.width > 1 else 0.1)

    @cached_property
    def numeric(self) -> tuple[int, ...]:
        """Columns of numbers, from the second half of the rows."""
        late = self.rows[len(self.rows) // 2 :]
        kinds: dict[int, Counter[int]] = {}
        for row in late:
            for column, cell in enumerate(row.cells):
                kinds.setdefault(column, Counter())[_kind(cell, self.decimal)] += 1
        return tuple(column for column, counts in sorted(kinds.items()) if counts[1] > counts[2])

    def is_data(self, row: _Row) -> bool:
        """Whether a row has numbers where its column has them; the first of them decides, which usually is the time."""
        kinds = [_kind(row.cells[column], self.decimal) for column in self.numeric if column < len(row.cells)]
        known = [kind for kind in kinds if kind]
        return bool(known) and known[0] == 1 and known.count(1) >= known.count(2)


def _dialect(encoding: str, split: _Split, remarks: Sequence[_Line], options: ReadOptions) -> Dialect:
    first = next((i for i, row in enumerate(split.rows) if split.is_data(row)), None)
    before = [row for row in split.rows[: len(split.rows) if first is None else first] if _has_text(row, split)]
    header: _Row | None
    if first is None:  # no numbers at all
        header, units, begin = (before or split.rows)[0], None, None
    else:
        begin = split.rows[first].line
        header, units = _header_of(before, split)
        if header is not None and sum(cell != "" for cell in header.cells) == 1 < split.width:
            header, units = None, None  # a title
        if header is None:
            above = [line for line in remarks if line.number < begin.number]
            header, units = _header_of(_remarked(above, split), split)
    names = () if header is None else _names(header.cells, split, first)
    width = split.width
    headers = _with_units(names, units) if header is not None else tuple(f"column {i + 1}" for i in range(width))
    notes = _notes(encoding, split, header, units, begin)
    if options.header:
        headers = options.header
    elif header is None:
        notes.append(f"no header row: line {begin.number if begin else 1} has numbers")
    end = split.rows[-1].line if begin is None and len(split.rows) == 1 else None
    if begin is None:
        after = [row.line for row in split.rows if header is not None and row.line.number > header.line.number]
        begin = after[0] if after else end
    assert begin is not None or header is not None
    offset, lines = (begin.start, begin.number - 1) if begin is not None and begin is not end else (-1, 0)
    if offset < 0:  # nothing follows the header
        last = split.rows[-1].line
        offset, lines = last.start + len(last.text.encode(encoding)), last.number
    return Dialect(
        encoding=encoding,
        delimiter=split.delimiter,
        decimal=split.decimal,
        headers=headers,
        width=len(headers) if width > len(headers) >= _filled_width(split, first) else width,
        header_line=0 if header is None or options.header else header.line.number,
        named=header is not None or bool(options.header),
        offset=offset,
        lines=lines,
        longest_remark=max((len(cells_of(line.text, split.delimiter)) for line in remarks if line.number > lines), default=0),
        cells=() if header is None else header.cells,
        first_row=split.rows[first].cells if first is not None else (),
        remarks=tuple(notes),
        proven=split.proven,
    )


def _header_of(before: Sequence[_Row], split: _Split) -> tuple[_Row | None, _Row | None]:
    """The rows of the names and of the units among the rows ``before`` the numbers."""
    if not before:
        return None, None
    last, above = before[-1], before[-2] if len(before) > 1 else None
    if above is None or len(above.cells) != len(last.cells) or any(_kind(cell, split.decimal) == 1 for cell in above.cells):
        return last, None
    if _are_units(last.cells):
        return above, last
    types = all(cell.strip("[]()").lower() in _TYPES for cell in last.cells if cell)
    return (above, None) if types or len({*last.cells}) < len({*above.cells}) else (last, None)


def _remarked(lines: Sequence[_Line], split: _Split) -> list[_Row]:
    """The last remarks before the numbers, split like rows, where they have as many cells: ``# time,x`` of NumPy."""
    rows = []
    for line in lines[-2:]:
        text = re.sub(rf"^\s*({'|'.join(map(re.escape, REMARKS))})+\s*", "", line.text)
        cells = cells_of(text, split.delimiter)
        if len(cells) == split.width > 1 and _has_text(_Row(line, cells), split):
            rows.append(_Row(line, cells))
    return rows


def _names(cells: Sequence[str], split: _Split, first: int | None) -> tuple[str, ...]:
    """The names of the columns; without cells at the end that are empty in the header and in all rows."""
    last = max(_filled(cells), min(len(cells), _filled_width(split, first)))
    return tuple(cell or f"column {i + 1}" for i, cell in enumerate(cells[:last]))


def _with_units(names: Sequence[str], units: _Row | None) -> tuple[str, ...]:
    """The headers, with the units of a row of units where a name has none."""
    if units is None:
        return tuple(names)
    joined = []
    for name, cell in zip(names, units.cells, strict=False):
        unit = cell.strip("[]() ")
        plain = not unit or unit == "-" or split_header(name)[1] is not None
        joined.append(name if plain else f"{name} [{unit}]")
    return (*joined, *names[len(joined) :])


def _are_units(cells: Sequence[str]) -> bool:
    named = [cell.strip("[]() ") for cell in cells]
    given = {unit for unit in named if unit not in ("", "-")}
    return bool(given) and all(len(unit) <= 12 and is_unit(unit) for unit in given)


def _notes(encoding: str, split: _Split, header: _Row | None, units: _Row | None, begin: _Line | None) -> list[str]:
    notes = []
    if encoding != "utf-8":
        notes.append(f"text in {encoding}")
    if (split.delimiter, split.decimal) != (",", "."):
        notes.append(f"cells separated by {_NAMES.get(split.delimiter, repr(split.delimiter))}")
    if split.decimal != ".":
        notes.append("decimal commas")
    if header is not None and header.line.number > 1:
        notes.append(f"header in line {header.line.number}{', a remark' if header.line.is_remark else ''}")
    if units is not None:
        notes.append(f"units in line {units.line.number}")
    after = max((row.line.number for row in (header, units) if row is not None), default=0)
    if begin is not None and header is not None and not header.line.is_remark and begin.number > after + 1:
        notes.append(f"numbers from line {begin.number}")
    return notes


def _has_text(row: _Row, split: _Split) -> bool:
    return any(_kind(cell, split.decimal) == 2 for cell in row.cells)


def _filled(cells: Sequence[str]) -> int:
    """Number of cells up to the last that is not empty, at least 1."""
    return max((i + 1 for i, cell in enumerate(cells) if cell), default=1)


def _filled_width(split: _Split, first: int | None) -> int:
    """Cells up to the last that is not empty in any row of numbers."""
    return max((_filled(row.cells) for row in split.rows[first:]), default=0) if first is not None else 0


@lru_cache(maxsize=2**12)
def _kind(cell: str, decimal: str) -> int:
    """0: a missing value, 1: a number, a list of numbers or a stamp, 2: text."""
    if cell.lower() in _MISSING:
        return 0
    return 1 if is_value(cell, decimal) else 2


def cells_of(text: str, delimiter: str) -> tuple[str, ...]:
    """The cells of one line, without white space around them."""
    line = text.strip("\r\n")
    if delimiter == " ":
        line = " ".join(line.split())
    csv.field_size_limit(MAX_LINE)
    try:
        row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        row = line.split(delimiter)
    return tuple(cell.strip() for cell in row) or ("",)


def _stated_delimiter(lines: Sequence[_Line]) -> str | None:
    """The delimiter of a first line ``sep=;``, which spreadsheets write."""
    match = re.fullmatch(r'"?sep=(.)"?\s*', lines[0].text, re.IGNORECASE) if lines else None
    return match[1] if match is not None and match[1] in DELIMITERS else None


def _first_lines(path: Path, encoding: str, start: int) -> list[_Line]:
    """The first lines that are not blank."""
    lines: list[_Line] = []
    letters = 0
    try:
        with path.open(encoding=encoding, newline="") as file:
            file.seek(start)
            for number, text in enumerate(iter(lambda: file.readline(MAX_LINE), ""), start=1):
                if len(text) == MAX_LINE:
                    raise InputError(path, f"a line of more than {MAX_LINE} letters", "one header row", "Is it a CSV file?")
                if text.strip():
                    lines.append(_Line(number, text, start))
                start += len(text.encode(encoding))
                letters += len(text)
                if len(lines) >= _LINES or (letters > _LETTERS and len(lines) > 2):
                    break
    except UnicodeError as error:
        raise InputError(path, f"not {encoding} text ({error})", "a text file", "Save it as UTF-8.") from None
    return lines


def _encoding(path: Path) -> tuple[str, int]:
    """The encoding, and the bytes of its mark at the begin."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    for mark, encoding in _ORDER_MARKS:
        if head.startswith(mark):
            return encoding, len(mark)
    half = max(1, len(head) // 2)
    for encoding, zeros in (("utf-16-le", head[1::2]), ("utf-16-be", head[::2])):
        if len(head) > 3 and zeros.count(0) > 0.8 * half and head.count(0) < 1.2 * half:
            return encoding, 0
    for encoding in ("utf-8", "cp1252"):
        try:
            text = head.decode(encoding)
        except UnicodeDecodeError as error:
            if encoding == "utf-8" and error.start >= len(head) - 3 and len(head) == _HEAD:
                return encoding, 0  # a letter that continues after the head
            continue
        if encoding == "utf-8" or not re.search(r"[\x00-\x08\x0e-\x1f]", text):
            return encoding, 0
    raise InputError(path, "bytes that are no text", "a CSV file in UTF-8", "Is it a CSV file?")
