"""Words that were replaced by terms of the field do not come back, and the glossary's files exist."""

from __future__ import annotations

import io
import re
import tokenize
from pathlib import Path

ROOT = Path(__file__).parents[2]

#: Parts of identifiers (``snake_case`` and ``CamelCase`` alike) → the term. The standard of each is docs/glossary.md.
RETIRED = {
    "likeness": "surrogate",
    "leeway": "half-width of the region of practical equivalence",
    "crumbs": "compensating parameters",
    "makeshift": "compensating parameters",
    "misshapen": "nonparametric alternative",
    "droops": "steady-state error",
    "senses": "estimator",
    "conduct": "state machine",
    "barrier": "command filter",
    "rehearse": "dry run",
    "rehearsal": "dry run",
    "whence": "provenance",
    "walked": "ingested",
    "clocked": "recording clocks",
    "looks": "windows",
    "unjudged": "not evaluated",
    "judge": "evaluate, check",
    "told": "informed, identified, recorded",
    "strange": "misspecified",
    "rival": "alternative",
    "rivals": "alternatives",
    "wish": "demand, setpoint, recording request",
    "wander": "drift",
    "wanders": "drifts",
    "heard": "received",
    "nobody": "the state that is meant",
    "sternest": "most severe",
    "believed": "estimated",
    "reckoned": "dead reckoning",
    "taught": "trained",
    "guilty": "responsible signal",
    "telling": "informative",
    "fate": "outcome",
    "trust": "uncertainty",
    "stands": "the state or position that is meant",
}
#: In the text of documentation, console and comments.
PHRASES = ("stand-in machine", "told apart", "from afar", "whence")
FOLDERS = ("sysid", "rl/sysid_rl", "pipelines/simulated_bench")
CODE = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
TEXT = sorted([*(ROOT / "docs").rglob("*.md"), ROOT / "README.md"])


def parts(identifier: str) -> set[str]:
    return {part.lower() for part in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", identifier)}


def test_no_retired_word_is_part_of_a_name() -> None:
    found = []
    for path in CODE:
        text = path.read_text("utf-8")
        if not any(parts(word) & RETIRED.keys() for word in set(re.findall(r"\w+", text))):
            continue  # neither in a name nor in a comment
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        names = {token.string: token.start[0] for token in tokens if token.type == tokenize.NAME}
        found += [
            f"{path.relative_to(ROOT)}:{line}: {name} (use: {RETIRED[word]})"
            for name, line in names.items()
            for word in parts(name) & RETIRED.keys()
        ]
    assert found == []


def test_no_retired_phrase_is_in_the_text() -> None:
    texts = {path: path.read_text("utf-8") for path in (*TEXT, *CODE)}
    assert [(str(path.relative_to(ROOT)), p) for path, text in texts.items() for p in PHRASES if p in text] == []


def test_files_that_the_glossary_names_exist() -> None:
    text = (ROOT / "docs" / "glossary.md").read_text("utf-8")
    named = [name for folder in FOLDERS for name in re.findall(rf"`({folder}/[\w/.]*)`", text)]
    assert len(named) > 40
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_parts_of_names() -> None:
    assert parts("StateEstimator") == {"state", "estimator"}
    assert parts("_MIN_LOOKS") == {"min", "looks"}
    assert parts("URDFFile2") == {"urdf", "file"}
