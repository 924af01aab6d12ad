"""Tables and figures of the paper with ours beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from committed import markdown

#: Largest error of the forward network, RMSE of both policies on the helix in simulation, largest errors of policy 1 in
#: simulation and on the machine; x, y, z [mm].
FORWARD_MAX = (15.9, 20.5, 13.6)
POLICY_RMSE = {"feedback": (17.0, 8.0, 10.0), "plain": (31.0, 17.0, 20.0)}
SIMULATION_MAX, MACHINE_MAX = (27.2, 14.5, 26.3), (75.2, 80.1, 73.1)
#: Its numbers of the policies.
NUMBER = {"feedback": 1, "plain": 2}


@dataclass(frozen=True)
class PaperRow:
    """One row of the result.

    Args:
        place: table or figure of the paper.
        quantity: what is compared; ``condition``: under which ours was measured.
        paper, ours: values in ``unit``; None where the paper states no number.
        seed: of ours; None where nothing is drawn.
        best: of the toolkit, by whatever method; ``command``: that makes it; ``seconds``: its processor time.
    """

    place: str
    quantity: str
    condition: str
    paper: tuple[float, ...] | None
    ours: tuple[float, ...]
    unit: str
    seed: int | None = None
    best: tuple[float, ...] | None = None
    command: str = ""
    seconds: float | None = None

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows as a table of the page."""
    head = ("in the paper", "quantity", "paper", "its method here", "unit", "condition")
    lines = [[row["place"], row["quantity"], *(_shown(row[key]) for key in ("paper", "ours")), row["unit"], row["condition"]]
             for row in rows]  # fmt: skip
    return markdown(head, lines, "llllll")


def best_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """What the paper states, what its method reaches here, and the best of the toolkit."""
    head = ("quantity", "paper", "its method here", "best here", "unit", "by", "processor time")
    lines = [
        [row["quantity"], *(_shown(row[key]) for key in ("paper", "ours", "best")), row["unit"], row["command"],
         f"{row['seconds']:.0f} s"]
        for row in rows if row.get("best") is not None and row["paper"] is not None
    ]  # fmt: skip
    return markdown(head, lines, "llllllr")


def _shown(values: Sequence[float] | None) -> str:
    if values is None:
        return "–"
    return " / ".join(f"{value:.1f}" if abs(value) < 100.0 else f"{value:.0f}" for value in values)
