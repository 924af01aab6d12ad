"""Some hundred damaged inputs of each target of ``make fuzz``, the same in every run; more of them by that command."""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "fuzz"))
from targets import TARGETS, forget

#: Tokens that stand where a value of a file stood.
TOKENS = (
    b"nan", b"-inf", b"1e400", b"1" * 400, b"-1", b"0", b'"../../x"', b'"\\u001b[31m"', b'"\\ud800"', b"[" * 500, b"{}", b"[]",
    b"null", b"''", b"\xff\xfe", b"\0", b"'", b'"', b"\n", b"= =", b"..", b"/", b"</robot>", b"<robot>" * 80, "\u202e".encode(),
)  # fmt: skip
#: Inputs of each target; a workspace takes ten times as long as a text, and whole verbs a thousand times.
COUNT = {
    "workspace": 20, "machine": 60, "urdf": 60, "recipe": 40, "mjcf": 15,
    "edges": 1, "current-folder": 1, "gap-result": 3, "arrivals": 12, "export-names": 30,
}  # fmt: skip


@pytest.fixture(autouse=True, scope="module")
def nothing_stays() -> Iterator[None]:
    yield
    forget()


def damaged(seed: bytes, rng: random.Random) -> bytes:
    content = bytearray(seed)
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(content) + 1)
        kind = rng.randrange(4)
        if kind == 0:
            del content[at : at + rng.choice((1, 4, 40))]
        elif kind == 1:
            content[at:at] = rng.choice(TOKENS)
        elif kind == 2:  # the value from here to the next separator
            ends = [content.find(end, at) for end in (b",", b"\n", b" ", b'"')]
            content[at : min((end for end in ends if end >= 0), default=at)] = rng.choice(TOKENS)
        elif content:
            content[at % len(content)] = rng.randrange(256)
    return bytes(content)


#: Whole verbs; the fast tier has strangers/test_edge_machines.py, test_current_folder.py, export/test_export_names.py,
#: fleet/test_watch_arrivals.py and reports/test_stored_result.py.
WHOLE = ("edges", "current-folder", "gap-result", "arrivals", "export-names")


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow if name in WHOLE else ()) for name in TARGETS])
def test_damaged_inputs_raise_nothing_but_our_errors(name: str) -> None:
    target, rng = TARGETS[name], random.Random(name)
    seeds = target.seeds()
    count = COUNT.get(name, 150)
    for seed in seeds[:count]:
        target.run(seed)
    for number in range(count):
        data = damaged(rng.choice(seeds), rng)
        try:
            target.run(data)
        except BaseException as error:
            raise AssertionError(f"{name}, input {number}: {data[:2000]!r}") from error
