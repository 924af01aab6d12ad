"""Names of a machine in the files of a target.

A target reserves names, cannot hold some letters, and needs different names within a namespace. A name of the machine is kept
where the target can hold it; else the nearest free name is written in its place. Names that are given to additions of the
target come last, so that they give way to those of the machine. The page of an export lists every name that differs.
"""

from __future__ import annotations

import itertools
import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

#: A name → what a target can hold of it, or what it compares of it.
Form = Callable[[str], str]


class Names:
    """One namespace of a target: each name in it is given once.

    Args:
        taken: names that the target reserves.
        form: the nearest name that the target can hold; the name itself where it can.
        fold: two names are the same to the target where this is.
        longest: length of a name [bytes of UTF-8].
    """

    def __init__(self, taken: Iterable[str] = (), form: Form = str, fold: Form = str, longest: int = 1000) -> None:
        self.form, self.fold, self.longest = form, fold, longest
        self.given = set(map(fold, taken))

    def new(self, name: str) -> str:
        """``name`` where it is possible and free, else the nearest one: numbered from 1."""
        stem = self.form(name) or self.form("unnamed")
        numbers = itertools.chain([""], (f"_{k}" for k in itertools.count(1)))
        found = next(each for number in numbers if self._free(each := self._cut(stem, len(number)) + number))
        self.given.add(self.fold(found))
        return found

    def each(self, names: Iterable[str]) -> dict[str, str]:
        """Name → the name that is given to it, in their order; those that can be kept are given first."""
        order = list(dict.fromkeys(names))
        found = {name: self.new(name) for name in sorted(order, key=lambda name: not self._kept(name))}
        return {name: found[name] for name in order}

    def _kept(self, name: str) -> bool:
        return self.form(name) == name == self._cut(name, 0) != "" and self._free(name)

    def _free(self, name: str) -> bool:
        return self.fold(name) not in self.given

    def _cut(self, name: str, less: int) -> str:
        return name.encode()[: self.longest - less].decode(errors="ignore")


def word(name: str) -> str:
    """ASCII letters, digits and underscores."""
    return re.sub("[^A-Za-z0-9_]", "_", name)


def identifier(name: str) -> str:
    """A word that a letter begins: the names of USD that all its importers keep."""
    plain = word(name)
    return plain if plain[:1].isalpha() or not plain else f"a_{plain}"


def scoped(name: str) -> str:
    """A name without the scope delimiter ``::`` of SDFormat, its reserved ``__…__`` and blanks at its ends, which it drops."""
    plain = re.sub("::+", "_", name).strip()
    return plain.strip("_") if plain.startswith("__") and plain.endswith("__") else plain


def same_file(name: str) -> str:
    """What file systems that ignore case and the composition of letters compare of a name."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


@dataclass(frozen=True)
class Renamed:
    """A part of a machine that has another name in the files: ``kind`` of part, its name, and the name that is written."""

    kind: str
    name: str
    written: str


@dataclass(frozen=True)
class MachineNames:
    """Names of the parts of a machine in the files of a target.

    Args:
        machine: (name, written name).
        axes: axis → what stands for it: a struct, the beginning of the names of its files.
        links, joints: of the URDF → in the target.
        driven: axis → its joint in the URDF.
        added: what the target adds to the machine → its name.
    """

    machine: tuple[str, str]
    axes: Mapping[str, str]
    links: Mapping[str, str] = field(default_factory=dict)
    joints: Mapping[str, str] = field(default_factory=dict)
    driven: Mapping[str, str] = field(default_factory=dict)
    added: Mapping[str, str] = field(default_factory=dict)

    def joint(self, axis: str) -> str:
        """The written name of the joint of an axis."""
        return self.joints[self.driven[axis]]

    @property
    def changed(self) -> tuple[Renamed, ...]:
        """Parts whose written name is not their own."""
        kinds = (("machine", dict([self.machine])), ("axis", self.axes), ("link", self.links), ("joint", self.joints),
                 ("addition", self.added))  # fmt: skip
        return tuple(Renamed(kind, *pair) for kind, names in kinds for pair in names.items() if pair[0] != pair[1])


def axis_names(machine: str, axes: Iterable[str], space: Names | None = None) -> MachineNames:
    """Those of a target without bodies: the names of the axes as they are, or as ``space`` has them."""
    return MachineNames((machine, machine), (space or Names()).each(axes))
