"""Makes a case of MuJoCo or PyBullet: ``site/`` with logs and description, and separately the truth, as :mod:`hidden.make`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hidden.cases import CaseSpec
from hidden.foreign.description import files_of
from hidden.foreign.kinds import BY_KEY
from hidden.foreign.limits import limit_of, scores_of
from hidden.foreign.machines import FORCE_AXIS, known_tables
from hidden.foreign.owner import kept_owner
from hidden.foreign.record import takes_of, write_logs
from hidden.foreign.truth import model_error, truths
from hidden.limits import overlaid_lists
from hidden.make import hide, with_known, write_recipe, write_sealed


def make_case(spec: CaseSpec, work: Path, nominal_plants: Path | None = None) -> dict[str, Any]:
    """Write the case; returns what is sealed.

    Args:
        nominal_plants: where the owners' fitted plants are kept, which every seed shares; ``work/nominal`` if not given.
    """
    known = with_known(known_tables(spec.family, spec.variant), spec, BY_KEY)
    owner = kept_owner(known, nominal_plants or work / "nominal")
    takes = takes_of(known, spec.excitation, spec.seed)
    # A start in motion is no part of an effect.
    still = [take for take in takes if take.lead == 0.0]
    real, hidden = known, []
    for each in spec.hidden:
        kind = BY_KEY[each.kind]
        limit = limit_of(kind, each.direction, known, scores_of(kind, known, owner, spec.noise, still))
        magnitude, described = hide(each, kind, limit)
        real = overlaid_lists(real, kind.change(known, magnitude, each.direction))
        hidden.append({**described, "floors_without": limit.without})
    effects = [effect for each in spec.hidden for effect in truths(BY_KEY[each.kind], known, real, owner, still)]
    site = work / "cases" / spec.name / "site"
    write_logs(real, takes, spec.noise, spec.seed, site / "logs")
    for name, text in files_of(known, owner.gains, owner.effects, spec.noise).items():
        (site / name).write_text(text, "utf-8")
    write_recipe(site, spec.family, [take.name for take in takes])
    error = {} if spec.family in FORCE_AXIS or not effects else model_error(known, real, owner, effects, still)
    return write_sealed(work, spec, hidden, effects, error)
