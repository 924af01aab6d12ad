"""Makes a foreign case: ``site/`` with logs and description, and apart from it the truth, laid out as the own bench does."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from hidden.cases import CaseSpec, Hidden
from hidden.foreign.description import files_of
from hidden.foreign.kinds import BY_KEY
from hidden.foreign.limits import limit_of, scores_of
from hidden.foreign.machines import FORCE_AXIS, Tables, known_tables
from hidden.foreign.owner import kept_owner
from hidden.foreign.record import takes_of, write_logs
from hidden.foreign.truth import model_error, truths
from hidden.kinds import Kind
from hidden.limits import Limit, overlaid_lists


def make_case(spec: CaseSpec, work: Path, nominal_plants: Path | None = None) -> dict[str, Any]:
    """Write the case; returns what is sealed.

    Args:
        nominal_plants: where the owners' fitted plants are kept, which every seed shares; ``work/nominal`` if not given.
    """
    known = machine_known(spec)
    owner = kept_owner(known, nominal_plants or work / "nominal")
    takes = takes_of(known, spec.excitation, spec.seed)
    # A start in motion is no part of an effect.
    still = [take for take in takes if take.lead == 0.0]
    real, hidden = known, []
    for each in spec.hidden:
        kind = BY_KEY[each.kind]
        limit = limit_of(kind, each.direction, known, scores_of(kind, known, owner, spec.noise, still))
        magnitude = min(max(each.factor * limit.magnitude, kind.least), kind.most)
        real = overlaid_lists(real, kind.change(known, magnitude, each.direction))
        hidden.append(_described(each, kind, limit, magnitude))
    effects = [effect for each in spec.hidden for effect in truths(BY_KEY[each.kind], known, real, owner, still)]
    site = work / "cases" / spec.name / "site"
    write_logs(real, takes, spec.noise, spec.seed, site / "logs")
    for name, text in files_of(known, owner.gains, owner.effects, spec.noise).items():
        (site / name).write_text(text, "utf-8")
    listed = ", ".join(f'"{take.name}"' for take in takes)
    (site / "recipe.toml").write_text(
        f'schema = 1\nname = "{spec.family}"\nmachine = "machine.toml"\nlogs = "logs"\n[recordings]\nmotion = [{listed}]\n'
        f'[splits]\nheld_out = ["{takes[-1].name}"]\n',
        "utf-8",
    )
    error = {} if spec.family in FORCE_AXIS or not effects else model_error(known, real, owner, effects, still)
    sealed = {"spec": spec.to_json(), "hidden": hidden, "effects": effects, "model_error": error}
    path = work / "sealed" / f"{spec.name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(sealed, indent=1) + "\n", "utf-8")
    return sealed


def machine_known(spec: CaseSpec) -> Tables:
    """The machine when nothing is hidden in it."""
    tables = known_tables(spec.family, spec.variant)
    for each in spec.hidden:
        tables = overlaid_lists(tables, BY_KEY[each.kind].known)
    return tables


def _described(each: Hidden, kind: Kind, limit: Limit, magnitude: float) -> dict[str, Any]:
    """``factor`` as it came out: a plausible machine may not have as much of an effect as was asked for."""
    return {
        "kind": each.kind,
        "effects": [{"name": name, "target": target} for name, target in kind.named],
        "magnitude": magnitude,
        "detection_limit": limit.magnitude if math.isfinite(limit.magnitude) else None,
        "floors_without": limit.without,
        "factor": magnitude / limit.magnitude if math.isfinite(limit.magnitude) else 0.0,
        "judged": kind.judged,
    }
