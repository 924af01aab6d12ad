"""The plant against the simulated test bench, effect by effect, with the remaining model error: reports/bench_agreement/.

    .venv/bin/python pipelines/bench_agreement.py

For every row a machine is recorded without noise, first without the feature of the row: a baseline (gain, delay, lag,
dead-band …) is fitted to that. Then the feature is switched on and the one effect is fitted, all others unchanged. Errors are
those of free runs on a recording that no fit has used.

Order of reading of agreement/: machines, rows, fitting, outcome, page.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from agreement.machines import ROOT, SEED
from agreement.outcome import Agreement, agreement
from agreement.page import table
from agreement.rows import ELSEWHERE, ROWS, Row
from committed import provenance, write_result, write_tables
from sysid.effects import CATALOGUE

PIPELINE = "pipelines/bench_agreement.py"
REPORT = ROOT / "reports" / "bench_agreement"
PAGE, RESULT = REPORT / "README.md", REPORT / "result.json"


def main(chosen: Sequence[Row] = ROWS, result: Path = RESULT, page: Path | None = PAGE) -> list[Agreement]:
    # The bench has no arm with masses: links are compared with closed forms (tests/plant/test_link_torque.py), as is the place
    # of a marker (tests/effects/test_references.py); loops of servos with MuJoCo (tests/gap/test_servo_controllers.py).
    shown = {e.name for e in CATALOGUE if not e.of_links and not e.described_only and e.actuations != ("servo",)}
    missing = shown - {row.effect for row in ROWS} - ELSEWHERE
    if missing:
        raise SystemExit(f"no machine shows {', '.join(sorted(missing))}: add a row to ROWS")
    rows = []
    for row in chosen:
        rows.append(agreement(row))
        print(
            f"{row.effect:20s} {row.machine_name:16s} {100 * rows[-1].share:6.1f} % left, {rows[-1].seconds:.0f} s", flush=True
        )
    found = {"rows": [{**asdict(row), "share": row.share} for row in rows]}
    write_result(result, provenance(f"python {PIPELINE}", SEED) | found)
    if page is not None:
        write_tables(page, table(rows), PIPELINE)
    return rows


if __name__ == "__main__":
    main()
