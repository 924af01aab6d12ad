"""The search at one stage of the small arm, as three kinds of tests ask for it."""

from __future__ import annotations

from sysid.datasets.recording import Dataset
from sysid.gap.case import open_case
from sysid.gap.stage_search import search_stages
from sysid.gap.strictness import Strictness
from sysid.plant import Plant


def named_at_slew(dataset: Dataset, plant: Plant, strict: Strictness) -> set[str]:
    """Names of the effects that are found between the slew's command and its joint."""
    case, stages = open_case(dataset, plant, 0)
    slew = [stage for stage in stages if stage.label == "command stage of slew"]
    (stage,) = search_stages(case, slew, strict, "all", lambda share, text: None)
    return {kept.candidate.effect.name for kept in stage.found.named}
