"""The two benches: `simulated_bench`, and the foreign simulators MuJoCo and PyBullet."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from hidden import cases, make
from hidden.cases import CaseSpec, Group, Tier
from hidden.foreign import cases as foreign_cases
from hidden.foreign import make as foreign_make

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "reports" / "hidden_effects" / "README.md"


@dataclass(frozen=True)
class Bench:
    """Where cases come from.

    Args:
        counts: cases of each group by tier; cases_of: tier, seed, group → the list; make: writes one.
        result: the committed figures. command: what regenerates them, and what the marks of their table say.
        packages: whose versions the figures depend on.
    """

    counts: Mapping[Tier, Mapping[Group, int]]
    cases_of: Callable[[Tier, int, Group | None], list[CaseSpec]]
    make: Callable[..., object]
    result: Path
    command: str
    packages: tuple[str, ...] = ()


BENCHES: Mapping[str, Bench] = {
    "own": Bench(
        cases.COUNTS,
        cases.cases_of,
        make.make_case,
        ROOT / "reports" / "hidden_effects" / "result.json",
        "pipelines/hidden_effects.py",
    ),
    "foreign": Bench(
        foreign_cases.COUNTS,
        foreign_cases.cases_of,
        foreign_make.make_case,
        ROOT / "reports" / "hidden_effects" / "foreign.json",
        "pipelines/hidden_effects.py --bench foreign",
        ("mujoco-core", "pybullet"),
    ),
}
