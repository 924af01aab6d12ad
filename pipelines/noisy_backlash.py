"""How often ``sysid gap`` names backlash behind a noisy sensor, and how wide it is: generated cranes with known backlash.

    .venv/bin/python pipelines/noisy_backlash.py --cases 100 [--seed N] [--workers 2] [--publish]

In each case the cylinder of the boom or of the stick has backlash between its rod, which a draw wire measures, and its joint.
The noise of the wire is 1/2 to 1/20 of the backlash; all else is as the owner describes it, but for a fluctuation of the flow.
The plant has the backlash at the joint, and the lever of the rod varies over its range: the true width is the best fit of the
plant to the same motion without noise of the wire. ``--publish`` writes the tables of ``reports/interval_coverage/`` and
``reports/noisy_backlash/result.json``.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from agreement.machines import parsed
from committed import markdown, provenance, write_result, write_tables
from hidden.limits import overlaid_lists
from hidden.machines import VARIANTS, recorded, visible_tables
from hidden.make import kept_nominal
from simulated_bench.case import BenchCase, overlaid, write_case
from simulated_bench.nominal import CommandChain
from simulated_bench.recipe import BenchRecipe, HiddenSettings
from sysid.datasets import ingest
from sysid.gap import find_gap
from sysid.gap.data import Data
from sysid.gap.fit import fit_candidates
from sysid.gap.prepare.case import Stage, open_case, stage_candidates
from sysid.plant import nominal_plant

ROOT = Path(__file__).resolve().parents[1]
PAGE, RESULT = ROOT / "reports" / "interval_coverage" / "README.md", ROOT / "reports" / "noisy_backlash" / "result.json"
AXES = ("boom", "stick")
#: Width of the backlash at the rod [m], and in standard deviations of the noise of the wire.
WIDTHS, RATIOS = (3e-4, 1.5e-3), (2.0, 20.0)
#: Relative fluctuation of the flow, in turn.
DISTURBANCES = (0.0, 0.001, 0.003)
#: Noise of the wire without noise [m], far below the least step of the log.
NO_NOISE = 1e-9
#: Largest relative error of a width that counts as right.
CLOSE = 0.05


@dataclass(frozen=True)
class Case:
    """One crane: width of the backlash at the rod [m], and in standard deviations of the noise of the wire."""

    number: int
    axis: str
    variant: int
    width: float
    ratio: float
    disturbance: float
    seed: int


@dataclass(frozen=True)
class Answer:
    """What was found, with the true width at the joint [rad]; ``width`` and ``interval`` are None without the name."""

    case: Case
    true: float
    width: float | None
    interval: tuple[float, float] | None
    others: tuple[tuple[str, str], ...]
    verdict: str

    @property
    def error(self) -> float:
        return abs(self.width / self.true - 1.0) if self.width is not None else np.inf

    @property
    def holds(self) -> bool:
        return self.interval is not None and self.interval[0] <= self.true <= self.interval[1]


def case_of(number: int, seed: int) -> Case:
    """Case ``number`` of a seed: width and ratio are uniform in their logarithms."""
    draw = np.random.default_rng([seed, number])
    width, ratio = (float(np.exp(draw.uniform(*np.log(ends)))) for ends in (WIDTHS, RATIOS))
    disturbance = DISTURBANCES[number % len(DISTURBANCES)]
    seeds = int(draw.integers(VARIANTS)), int(draw.integers(1, 2**30))
    return Case(number, AXES[number % len(AXES)], seeds[0], width, ratio, disturbance, seeds[1])


def written(case: Case, noise: float, folder: Path, nominal_plants: Path) -> Path:
    """The logs and description of a case, with this noise of the wire [m]; returns their folder."""
    visible = recorded(visible_tables("valve_crane", case.variant), "rich", 1.0, case.disturbance, case.seed)
    visible = overlaid(visible, {"draw_wire": {"noise": noise}})
    owner, real = (
        parsed(tables, "crane")
        for tables in (visible, overlaid_lists(visible, {"axes": {case.axis: {"backlash": case.width}}}))
    )
    assert isinstance(owner, BenchRecipe)
    assert isinstance(real, BenchRecipe)
    nominal: CommandChain = kept_nominal(owner, nominal_plants)
    write_case(BenchCase("crane", owner, real, (HiddenSettings("backlash", case.axis),)), folder, nominal)
    return folder / "site"


def best_width(case: Case, site: Path, workspace: Path) -> float:
    """Width at the joint that fits the stage of the linkage best [rad]."""
    dataset = ingest(site, workspace)
    opened, stages = open_case(dataset, nominal_plant(dataset.machine), 0)
    stage: Stage = next(s for s in stages if (s.problem.stage, s.problem.target) == ("joint", case.axis))
    backlash = next(c for c in stage_candidates(opened, stage) if c.effect.name == "backlash")
    data = Data(stage.problem, stage.split.seen, stage.sigma)
    return float(fit_candidates(data, stage.theta, (backlash,), [np.array(s) for s in backlash.starts]).values[0])


def answered(case: Case, nominal_plants: Path) -> Answer:
    """The answer of ``sysid gap`` on a case."""
    with tempfile.TemporaryDirectory() as work:
        place = Path(work)
        true = best_width(case, written(case, NO_NOISE, place / "exact", nominal_plants), place / "exact-workspace")
        site = written(case, case.width / case.ratio, place / "noisy", nominal_plants)
        dataset = ingest(site, place / "workspace")
        result = find_gap(dataset, nominal_plant(dataset.machine))
    found = [e for e in result.effects if (e.name, e.target) == ("backlash", case.axis)]
    others = tuple((e.name, e.target) for e in result.effects if e not in found)
    if not found:
        return Answer(case, true, None, None, others, result.verdict)
    width, (low, high) = found[0].parameters["width"], found[0].interval95["width"]
    return Answer(case, true, float(width), (float(low), float(high)), others, result.verdict)  # type: ignore[arg-type]


def kept(case: Case, work: Path) -> Answer:
    """The answer, which is not computed again."""
    path = work / f"{case.seed}.json"
    if not path.exists():
        answer = answered(case, work / "nominal")
        path.write_text(json.dumps(asdict(answer)), "utf-8")
        print(_line(answer), flush=True)
    known = json.loads(path.read_text("utf-8"))
    interval = tuple(known["interval"]) if known["interval"] else None
    others = tuple((name, target) for name, target in known["others"])
    return Answer(Case(**known["case"]), known["true"], known["width"], interval, others, known["verdict"])


def _line(answer: Answer) -> str:
    case = answer.case
    found = f"error {answer.width / answer.true - 1.0:+.3f}, holds {answer.holds}" if answer.width else answer.verdict
    return f"{case.number:3d} {case.axis:5s} {case.ratio:4.1f} standard deviations: {found}; others {list(answer.others)}"


def table_of(answers: list[Answer]) -> str:
    """By ratio: cases, named, errors, intervals, wrong names."""
    ends = (2.0, 4.0, 8.0, 20.0)
    parts = [
        (f"{low:g} to {high:g}", [a for a in answers if low <= a.case.ratio < high]) for low, high in itertools.pairwise(ends)
    ]
    rows = []
    for label, part in (*parts, ("all", answers)):
        named = [a for a in part if a.width is not None]
        errors = [a.error for a in named]
        rows.append(
            (
                label,
                str(len(part)),
                str(len(named)),
                f"{100.0 * float(np.median(errors)):.1f}, {100.0 * max(errors):.1f} %" if errors else "–",
                str(sum(a.error <= CLOSE for a in named)),
                str(sum(a.holds for a in named)),
                str(sum(bool(a.others) for a in part)),
            )
        )
    header = (
        "width in standard deviations", "cases", "named", "error, median and largest", "within 5 %", "interval contains it",
        "cases with another name",
    )  # fmt: skip
    return markdown(header, rows)


def main(cases: int, seed: int, workers: int, work: Path, publish: bool) -> None:
    work = work / f"seed-{seed}"
    work.mkdir(parents=True, exist_ok=True)
    specs = [case_of(k, seed) for k in range(cases)]
    with ProcessPoolExecutor(workers, multiprocessing.get_context("forkserver")) as pool:
        answers = list(pool.map(partial(kept, work=work), specs))
    print(table_of(answers))
    if publish:
        command = f"python pipelines/noisy_backlash.py --cases {cases} --seed {seed} --publish"
        write_result(RESULT, {**provenance(command, seed), "answers": [asdict(a) for a in answers]})
        write_tables(PAGE, table_of(answers), "pipelines/noisy_backlash.py")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--work", type=Path, default=ROOT / "workspace" / "noisy_backlash", help="folder of answers")
    parser.add_argument("--publish", action="store_true", help="write the tables of the page")
    given = parser.parse_args()
    main(given.cases, given.seed, given.workers, given.work, given.publish)
