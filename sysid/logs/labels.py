"""Labels of the elements of arrays in messages: ``position[boom]``, ``transforms[boom_body].transform.translation.x``.

Two structures say which element is which:

- *names beside an array*: an array of texts ``name``, ``names`` or ``…_names`` labels the arrays of numbers and of messages in
  the same message that have its length. ``joint_names`` also labels arrays in the messages below it, as in a trajectory of
  ``trajectory_msgs`` or the state of a controller of ``control_msgs``, up to messages that have names of their own;
- *a text in every element* of an array of messages that identifies it (:func:`identifying`).

An empty text, one that occurs twice in its array, and one with a bracket label nothing. A whole number in brackets is an index;
a label that is a whole number stands in quotes: ``rigidbodies["7"]``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from sysid.errors import InputError

_NAMES = re.compile(r"(?:.*_)?names?|.*[a-z0-9]Names?")
_BRACKETS = re.compile(r"\[([^\[\]]*)\]")
_JOINT_NAMES = ("joint_names", "jointNames")
#: Texts that identify an element, the surest first: its name, the frame of a transform, the name of a body or subject, its id.
_IDENTIFYING = tuple(map(re.compile, ("name", "child_frame_id|childFrameId", r".+_name|.*[a-z0-9]Name", "id")))


@lru_cache(4096)
def are_names(member: str) -> bool:
    """Whether an array of texts called ``member`` names the elements of arrays."""
    return _NAMES.fullmatch(member) is not None


def are_joint_names(member: str) -> bool:
    """Whether these names also label arrays in messages below."""
    return member in _JOINT_NAMES


@lru_cache(256)
def identifying(texts: tuple[str, ...]) -> str | None:
    """Of the names of the texts of a message the one that identifies it within an array; None where there is none."""
    return next((text for pattern in _IDENTIFYING for text in texts if pattern.fullmatch(text)), None)


@lru_cache(256)
def bracketed(texts: tuple[str, ...]) -> tuple[str, ...]:
    """What stands in brackets for each element; empty for an element without a label."""
    counts = Counter(texts)
    return tuple(
        "" if not text or counts[text] > 1 or "[" in text or "]" in text else f'"{text}"' if text.isdecimal() else text
        for text in texts
    )


def without_repeats(columns: Iterable[str]) -> list[str]:
    """Paths without those by index that paths by label repeat: ``position[2]`` beside ``position[boom]``."""
    columns = list(columns)
    labelled = {(_BRACKETS.sub("[]", name), k) for name in columns for k, text in _places(name) if not text.isdecimal()}
    return [
        name
        for name in columns
        if not any(text.isdecimal() and (_BRACKETS.sub("[]", name), k) in labelled for k, text in _places(name))
    ]


def _places(path: str) -> list[tuple[int, str]]:
    """Number and content of each pair of brackets of a path."""
    return list(enumerate(_BRACKETS.findall(path)))


@dataclass
class ArrayLabels:
    """The labels of the arrays of one topic over all messages."""

    #: Array → the text of each element as it was first seen.
    _first: dict[str, list[str]] = field(default_factory=dict)
    #: Array → its texts as they were last seen.
    _last: dict[str, tuple[str, ...]] = field(default_factory=dict)
    #: Array, index → two texts that it had.
    _moved: dict[tuple[str, int], tuple[str, str]] = field(default_factory=dict)
    #: Array, text → number of messages in which two elements had it.
    _repeated: Counter[tuple[str, str]] = field(default_factory=Counter)

    def saw(self, array: str, texts: tuple[str, ...]) -> None:
        """Note the texts of the elements of an array in a message."""
        if self._last.get(array) == texts:
            return
        self._last[array] = texts
        first = self._first.setdefault(array, list(texts))
        first += texts[len(first) :]
        for index, text in enumerate(texts):
            if text != first[index] and text:
                if first[index]:
                    self._moved.setdefault((array, index), (first[index], text))
                else:
                    first[index] = text

    def repeated(self, array: str, texts: Sequence[str], messages: int = 1) -> None:
        """Note the texts that elements of an array share in ``messages`` messages."""
        if len({*texts}) < len(texts):
            self._repeated.update({(array, text): messages for text, count in Counter(texts).items() if text and count > 1})

    @property
    def losses(self) -> tuple[str, ...]:
        """What has no value because two elements have one label."""
        return tuple(
            f"{count} messages have two elements {text!r} in {array}: {array}[{text}] is missing there"
            for (array, text), count in self._repeated.items()
        )

    def check(self, path: str, known: Container[str], where: object) -> None:
        """Check that a field is the same thing in every message.

        Args:
            known: the fields that were found.

        Raises:
            InputError: an index in it is another element in other messages, or two elements always have its label.
        """
        for match in _BRACKETS.finditer(path):
            array, text, rest = path[: match.start()], match[1], path[match.end() :]
            if text.isdecimal() and (array, int(text)) in self._moved:
                texts = self._moved[array, int(text)]
                found = f"{array}[{text}] is {texts[0]!r} in some messages and {texts[1]!r} in others"
                named = [f"{array}[{label}]{rest}" for label in bracketed(texts) if label]
                raise InputError(f"{where}: {path}", found, " or ".join(named), "Name the element in `field` of the recipe.")
            count = self._repeated[array, text.strip('"')]
            if count and path not in known:
                found = f"two elements {text!r} in {array} in {count} messages"
                raise InputError(f"{where}: {path}", found, "one element a name", "Record it with different names.")
