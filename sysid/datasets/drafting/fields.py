"""The columns of all logs as series, and what their names say: axis and quantity; and what only the user
knows.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sysid.datasets.chunked import Array
from sysid.datasets.layouts import ONE_TABLE, TABLES
from sysid.datasets.quality.noise import is_still
from sysid.datasets.words import NO_SIGNAL, UNITS, WORDS, said, words_of
from sysid.errors import SettingsError, nearest
from sysid.logs.inspection import FileSummary
from sysid.logs.labels import without_repeats
from sysid.logs.lerobot import LeRobotReader
from sysid.logs.reader import ReadOptions, Stream, read_confined
from sysid.logs.readers import reader_named
from sysid.numbers import LARGEST_COUNT

#: Of longer recordings the first two hours are enough [s].
MAX_SECONDS = 7200.0
#: What letters and words say that mean a quantity only beside each other: ``u1`` and ``y1``, ``lift in`` and ``lift out``.
BESIDE: Mapping[str, frozenset[str]] = {
    "command": frozenset({"u", "in", "inp"}),
    "measured": frozenset({"y", "x", "out", "output"}),
}


@dataclass(frozen=True)
class Series:
    """The samples of a column in one recording: times [s] and values, (n,) each."""

    recording: str
    time: Array
    values: Array


@dataclass(frozen=True)
class Field:
    """A column over all recordings.

    Args:
        topic: of a bag; of a table its file's stem where a recording has several files, else empty.
        table: whether it is in a file with one table.
        unit: as the files state it.
        axis: words of its name that are no quantity; empty where there is none.
        says: quantities that its name says.
    """

    topic: str
    name: str
    table: bool
    unit: str | None
    series: tuple[Series, ...]
    axis: str
    says: frozenset[str]

    @property
    def label(self) -> str:
        return f"{self.topic} {self.name}".strip()

    @property
    def values(self) -> Array:
        """All finite values."""
        joined: Array = np.concatenate([np.empty(0), *(series.values for series in self.series)])
        return joined[np.isfinite(joined)]


def read_fields(files: Sequence[FileSummary], recordings: Mapping[Path, str]) -> list[Field]:
    """The columns that change in any file, in the order of the files; stamps are left out. An episode is a recording.

    Raises:
        InputError: a file that cannot be read.
    """
    files_of, found = Counter(recordings[file.path] for file in files), dict[tuple[str, str], list[Series]]()
    units, tables = dict[tuple[str, str], str | None](), set[tuple[str, str]]()
    for file in files:
        options = ReadOptions(header=file.columns, seconds=MAX_SECONDS, **file.stated)
        for stream in read_confined(reader_named(file.reader, file.path), file.path, options):
            episode = file.reader == LeRobotReader().name
            recording = stream.name if episode else recordings[file.path]
            several = files_of[recordings[file.path]] > 1 and not episode
            topic = stream.name if file.reader not in ONE_TABLE else file.path.stem if several else ""
            for name in (name for name in without_repeats(stream.columns) if not NO_SIGNAL.search(name)):
                values = stream.columns[name]
                known = np.where(np.abs(values) <= LARGEST_COUNT, values, np.nan)  # overflows
                found.setdefault((topic, name), []).append(Series(recording, _seconds(stream), known))
                units.setdefault((topic, name), stream.units.get(name))
                tables |= {(topic, name)} if file.reader in TABLES else set()
    moving = {key: series for key, series in found.items() if not all(is_still(one.values) for one in series)}
    shared = (
        frozenset.intersection(*(frozenset(words_of(f"{topic} {name}")) for topic, name in moving)) if moving else frozenset()
    )
    return [_field(*key, key in tables, units[key], series, shared) for key, series in moving.items()]


def _field(topic: str, name: str, table: bool, unit: str | None, series: Sequence[Series], shared: frozenset[str]) -> Field:
    in_brackets = r"\((?!\d+\))[^()]*\)"  # a unit; a number is that of an axis, and a message has labels in square ones
    in_brackets += r"|\[[^\[\]\d]*\]" if table else ""
    words = words_of(re.sub(in_brackets, " ", f"{topic} {name}"))
    says = said(words) or frozenset(quantity for quantity, known in BESIDE.items() if known & {*words})
    known = frozenset().union(*WORDS.values()) | UNITS
    labels = [] if table else [label for label in re.findall(r"\[([^\[\]]*)\]", name) if not label.isdecimal()]
    named = [word for word in words_of(" ".join(labels)) if word not in known]
    known |= (shared if len(words) > 1 else frozenset()) | frozenset().union(*BESIDE.values())
    axis = "_".join(named or [word for word in words if word not in known])
    return Field(topic, name, table, unit or _unit_in(name), tuple(series), axis, says)


def _unit_in(name: str) -> str | None:
    """The unit in brackets or at the end of a name: ``Boom (mm)``, ``q1_deg``."""
    bracket = re.search(r"[(\[]\s*(deg|rad|turns?|mm|cm|m|°|Nm|N·m|N|%)\s*[)\]]\s*$", name)
    ending = re.search(r"_(deg|rad|turns?|mm|cm|m|nm|n)$", name, re.IGNORECASE)
    text = (bracket or ending)[1] if bracket or ending else None  # type: ignore[index]
    return {"°": "deg", "nm": "N·m", "n": "N"}.get(text.lower(), text.lower() if ending else text) if text else None


def _seconds(stream: Stream) -> Array:
    stamps = next(iter(stream.stamps.values()))
    return np.asarray(stamps * 1e-9, dtype=np.float64)


@dataclass(frozen=True)
class Question:
    """What only the user knows.

    Args:
        key: what ``--set KEY=VALUE`` answers.
        proposal: taken with ``--yes``.
        why: what the data show, as a sentence.
        choices: possible values; empty: any.
    """

    key: str
    proposal: str
    why: str
    choices: tuple[str, ...] = ()


@dataclass
class Answers:
    """Answers by key, and the questions that were asked so far.

    Args:
        prompted: keys that were asked at a prompt: another answer there may have settled them.
    """

    given: Mapping[str, str]
    prompted: frozenset[str] = frozenset()
    asked: list[Question] = field(default_factory=list)
    used: set[str] = field(default_factory=set)

    def of(self, question: Question, sure: bool = False) -> str:
        """The answer, or the proposal where there is none yet.

        Args:
            sure: the data decide: nothing is asked, but an answer counts.

        Raises:
            SettingsError: an answer that is not one of the choices.
        """
        value = self.given.get(question.key)
        self.used.add(question.key)
        if value is None:
            if not sure and all(question.key != other.key for other in self.asked):
                self.asked.append(question)
            return question.proposal
        if question.choices and value not in question.choices:
            raise SettingsError(f"--set {question.key}={value}", "no choice", nearest(value, question.choices))
        return value

    def check_used(self) -> None:
        """Raise SettingsError where an answer has no question."""
        for key in self.given:
            if key not in self.used | self.prompted:
                raise SettingsError(f"--set {key}", "no such question", nearest(key, self.used) if self.used else "none")
