"""What each deciding step of the gap workflow buys: the same sealed cases, answered with one step left out at a time.

    .venv/bin/python pipelines/ablation.py [--none N] [--single N] [--seed N|commit] [--workers N]

With the seed of the commit, on a tree without changes, it writes reports/hidden_effects/ablation.json and its table in
docs/hidden-effects.md; with --seed N nothing but the work folder. A stopped run goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from committed import provenance, write_result, write_tables
from hidden.cases import CaseSpec, case
from hidden.judge import judge
from hidden.make import make_case
from hidden.runner import ANSWERING, MAKING, Place, run_process
from hidden.score import scored
from hidden.seed import Seed, check_unchanged, seed_of
from hidden.solve import solve
from sysid.gap.strictness import Strictness

ROOT = Path(__file__).resolve().parents[1]
RESULT = ROOT / "reports" / "hidden_effects" / "ablation.json"
PAGE = ROOT / "docs" / "hidden-effects.md"
#: What is left out, and which settings of the search leave it out.
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "nothing left out": {},
    "naive BIC: every sample counts as independent, nothing but ΔBIC > 10 decides": {"whitened": False},
    "no excitation gate": {"gate": False},
    "frozen baseline: gain and dead time as the owner fitted them": {"free": False},
    "no doubt where a stage stays unexplained": {"doubt": 1.0, "clearer": 1.0},
}
RATES = ("false_naming_none", "single_right", "single_wrong", "wrong_name")


def answer_all(specs: Sequence[CaseSpec], work: Path, workers: int) -> None:
    """Every case, made once and answered in every variant."""
    place = Place(work)
    settings = []
    for number, changed in enumerate(VARIANTS.values()):
        folder = answers_of(work, number)
        folder.mkdir(parents=True, exist_ok=True)
        settings.append((folder, Strictness(**changed)))

    def one(spec: CaseSpec) -> None:
        begin = time.perf_counter()
        waiting = [(folder, strict) for folder, strict in settings if not (folder / f"{spec.name}.json").exists()]
        if not waiting:
            return
        made = run_process(make_case, [spec, work, place.nominal], MAKING)
        for folder, strict in waiting:
            out = folder / f"{spec.name}.json"
            failure = made or run_process(solve, [place.site(spec), out, strict], ANSWERING)
            if failure:
                out.write_text(json.dumps({"failure": failure}) + "\n", "utf-8")
        shutil.rmtree(place.site(spec).parent, ignore_errors=True)
        print(f"{spec.name:12s} {time.perf_counter() - begin:6.1f} s", flush=True)

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(one, specs))


def answers_of(work: Path, number: int) -> Path:
    """Where the answers of a variant lie."""
    return work / f"variant-{number}"


def result_of(specs: Sequence[CaseSpec], seed: Seed, work: Path, command: str) -> dict[str, Any]:
    """Rates of every variant over the cases that could be made."""
    place, rows = Place(work), []
    for number, (label, changed) in enumerate(VARIANTS.items()):
        cases = []
        for spec in specs:
            if place.sealed(spec).exists():
                sealed = json.loads(place.sealed(spec).read_text("utf-8"))
                cases.append(judge(sealed, json.loads((answers_of(work, number) / f"{spec.name}.json").read_text("utf-8"))))
        found = scored(cases)
        rows.append(
            {
                "left_out": label,
                "settings": dict(changed),
                "rates": {key: found["rates"][key] for key in RATES},
                "seconds": found["seconds"],
            }
        )
    return provenance(command, seed.value) | {"commit": seed.commit, "cases": len(specs), "variants": rows}


def table_of(result: Mapping[str, Any]) -> str:
    """The rates as a Markdown table."""
    lines = [
        f"{result['cases']} cases, seed {result['seed']}: `{result['command']}`.",
        "",
        "| left out | nothing hidden: named | one effect: right | — wrong name | any case: wrong name | seconds |",
        "| --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for row in result["variants"]:
        rates = (f"{row['rates'][key]['hits']} of {row['rates'][key]['cases']}" for key in RATES)
        lines.append(f"| {row['left_out']} | {' | '.join(rates)} | {row['seconds']['median']:.0f} |")
    return "\n".join(lines)


def main(none: int, single: int, seed: Seed, work: Path, workers: int) -> dict[str, Any]:
    """Answer, and write what may be published."""
    specs = [*(case("none", k, seed.value) for k in range(none)), *(case("single", k, seed.value) for k in range(single))]
    place = work / f"seed-{seed.value}"
    answer_all(specs, place, workers)
    command = f"python pipelines/ablation.py --none {none} --single {single}"
    result = result_of(specs, seed, place, command + ("" if seed.published else f" --seed {seed.value}"))
    write_result(place / "ablation.json", result)
    if seed.published:
        check_unchanged(seed, ROOT)
        write_result(RESULT, result)
        write_tables(PAGE, table_of(result), "pipelines/ablation.py")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--none", type=int, default=20, help="cases that hide nothing")
    parser.add_argument("--single", type=int, default=26, help="cases that hide one effect")
    parser.add_argument("--seed", default="commit", help="of the cases: a number, or 'commit' (default), whose result is kept")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--work", type=Path, default=ROOT / "workspace" / "ablation", help="folder of cases and answers")
    given = parser.parse_args()
    try:
        print(table_of(main(given.none, given.single, seed_of(given.seed, ROOT), given.work, given.workers)))
    except ValueError as error:
        parser.exit(2, f"{error}\n")
