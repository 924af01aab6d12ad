"""A stored case under every trial, and what the trials change."""

from __future__ import annotations

import contextlib
import json
import sys
import threading
from collections import Counter
from collections.abc import Callable, Container, Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import Any

from sysid.gap.thresholds import as_little
from trials.replaced import holders
from trials.rules import CONDITIONS, TRIALS, Changes
from trials.stored import Answer, stored_case


def decide_case(stored: Path, out: Path) -> None:
    """Write the answer of every trial about a stored case; what the trials ask is stored with it."""
    case = stored_case(stored)
    case.answer({})  # what it asks for the first time is no part of the decision
    with entered_modules() as entered:
        first = case.answer({})
    answers = {name: case.answer(changes) if reaches(changes, entered) else first for name, changes in TRIALS.items()}
    needed = needed_conditions(answers, case.answer)
    case.write(stored)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps({"hidden": case.hidden, "answers": answers, "needed": needed}, indent=1) + "\n", "utf-8")


@contextlib.contextmanager
def entered_modules() -> Iterator[set[str]]:
    """Names of the modules of which a function is called, in all threads that begin meanwhile."""
    found: set[str] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            found.add(frame.f_globals.get("__name__", ""))

    sys.setprofile(note)
    threading.setprofile(note)
    try:
        yield found
    finally:
        sys.setprofile(None)
        threading.setprofile(None)


def reaches(changes: Changes, entered: Container[str]) -> bool:
    """Whether a changed constant is in a module that a decision enters; a changed function may be anywhere."""
    if any(callable(new) for new in changes.values()):
        return True
    return not changes or any(module.__name__ in entered for where in changes for module in holders(where))


def answers_of(stored: Path) -> tuple[Answer, Answer]:
    """The answer of the rule with which a case was searched, and that of the rule as it is now."""
    case = stored_case(stored)
    return case.first, case.answer({})


def needed_conditions(answers: Mapping[str, Answer], decided: Callable[[Changes], Answer]) -> list[str]:
    """Conditions without which the answer is worse, where all the others are switched off together.

    One that changes nothing alone may stand for another one like it. They go one after the other, in their order.
    """
    before, off = answers[""], dict[str, Any]()
    spare = [name for name in CONDITIONS if not worse(answers[name], before)]
    together = {where: new for name in spare for where, new in CONDITIONS[name].items()}
    if not worse(decided(together), before):
        return [name for name in CONDITIONS if name not in spare]
    left = []
    for name in spare:
        further = {**off, **CONDITIONS[name]}
        if worse(decided(further), before):
            left.append(name)
        else:
            off = further
    return [name for name in CONDITIONS if name not in spare or name in left]


def worse(answer: Answer, before: Answer) -> bool:
    """Whether an answer has more wrong names or misses more effects."""
    return any(len(answer[key]) > len(before[key]) for key in ("wrong", "missed"))


def verdict(answer: Answer) -> str:
    return "wrong" if answer["wrong"] else "incomplete" if answer["missed"] else "exact"


def changed(cases: Mapping[str, Mapping[str, Answer]]) -> dict[str, dict[str, Any]]:
    """Trial → how many answers change, from which verdict to which, and the cases; stages whose plant leaves more, or less.

    Args:
        cases: by name, the answer of every trial (the same ones in all of them); that of the rule itself has no name.
    """
    table: dict[str, dict[str, Any]] = {}
    for trial in next(iter(cases.values()), {}):
        moves, names, plants = Counter[str](), [], Counter[str]()
        for name, answers in cases.items():
            before, after = answers[""], answers[trial]
            plants += compared_plants(before, after)
            if [before["named"], before["ties"]] != [after["named"], after["ties"]]:
                moves[f"{verdict(before)} → {verdict(after)}"] += 1
                names.append(name)
        if trial:
            table[trial] = {"changed": len(names), "moves": dict(sorted(moves.items())), "cases": names, "plants": dict(plants)}
    return table


def compared_plants(before: Answer, after: Answer) -> Counter[str]:
    """Number of stages of which the repaired plant leaves ``more``, or ``less``, by over a tenth of error or floor."""
    first, then = (answer.get("left", {}) for answer in (before, after))  # none in answers that are older
    pairs = [(first[stage], then[stage]) for stage in first if stage in then]
    return Counter(more=sum(not as_little(b, a) for a, b in pairs), less=sum(not as_little(a, b) for a, b in pairs))
