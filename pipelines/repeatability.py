"""Repeatability of names and values over recordings, as a table."""

from __future__ import annotations

from collections.abc import Sequence

from sysid.cli.output import Printer
from sysid.gap.repeatability import RepeatedEffect
from sysid.machine import Machine


def show_repeatability(out: Printer, repeats: Sequence[RepeatedEffect], machine: Machine) -> None:
    """Share of the runs in which each effect was named, and the spread of its values."""
    from sysid.reports.result_figures import parameters_of

    if not repeats:
        out.line("no effect was named in any run")
        return
    words = {
        "consistent": "consistent",
        "moves": "NOT consistent: value varies",
        "sometimes": "NOT consistent: not named in all runs",
    }
    rows = []
    for item in repeats:
        first = (item.name, item.target, f"{len(item.named)} of {len(item.shown)}")
        for number, (key, values) in enumerate(item.parameters.items()):
            low, middle, high = (
                parameters_of(item.name, item.target, {key: value}, machine)[0].text
                for value in (min(values), item.median(key), max(values))
            )
            tail = (key, middle, f"{low} … {high}", f"{100.0 * item.spread(key):.0f} %")
            rows.append((*(first if number == 0 else ("", "", "")), *tail, words[item.verdict] if number == 0 else ""))
    out.table(("effect", "target", "named in", "parameter", "median", "range", "±", "over the runs"), rows, right=(2, 4, 5, 6))
