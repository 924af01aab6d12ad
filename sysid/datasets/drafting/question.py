"""A decision that the data do not make, with a proposal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sysid.errors import SettingsError, nearest


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
