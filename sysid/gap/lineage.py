"""Lineage of a repaired plant: its data and settings, the evidence for its effects, and the software."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from sysid.extras import versions_of
from sysid.files import plain
from sysid.gap.prepare.case import Case
from sysid.gap.proof import ProofOutcome
from sysid.gap.result import Gap
from sysid.release import __version__

#: Packages that the results of the workflow depend on.
SOFTWARE = ("numpy", "scipy", "numba", "pandas", "arch")


def lineage_of(case: Case, outcome: ProofOutcome, gap: Gap, stage_gap: Gap, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Plain JSON values. A repeated run gives the same values, and so no new version."""
    return plain(  # type: ignore[no-any-return]
        {
            "dataset_digest": case.dataset.digest,
            "recordings": {role: [r.name for r in getattr(case.split, role)] for role in ("fit", "select", "held_out")},
            "seed": case.seed,
            "settings": {**settings, "noise": dict(case.noise)},
            "named": [f"{e.name}({e.target})" for e in outcome.named],
            "effects": [
                {
                    "name": e.name,
                    "target": e.target,
                    "side": e.side,
                    "parameters": dict(e.parameters),
                    "units": dict(e.units),
                    "interval95": {key: list(ends) for key, ends in e.interval95.items()},
                    "closed_share": e.gap_share,
                    "evidence": asdict(e.evidence) if e.evidence is not None else None,
                }
                for e in outcome.named
            ],
            "ties": outcome.ties,
            "unnamed_residual": [" of ".join(item.key) for item in outcome.repaired.residuals],
            "proof": {"gap": asdict(gap), "stage_gap": asdict(stage_gap)},
            "notes": outcome.notes,
            "software": {
                "sysid": __version__,
                "python": platform.python_version(),
                **versions_of(SOFTWARE),
            },
        }
    )
