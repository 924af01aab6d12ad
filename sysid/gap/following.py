"""Parts of a result that follow the decision: one that fails is listed as missing with its reason, and the answer stays.

They measure the decided effects, store the repair, and plan recordings; none of them changes a name. The answer is kept before
the first of them, since they may take longer than the search, or be interrupted.
"""

from __future__ import annotations

import itertools
import traceback
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sysid.errors import ExcitationError, SysidError
from sysid.gap import steps
from sysid.gap.breakdown import maps_of, shares_of
from sysid.gap.experiment import Planning, open_hypotheses, propose
from sysid.gap.result import Excitation, GapResult, Unnamed
from sysid.gap.statement import Agreement, Missing, Verdict, verdict_of
from sysid.gap.written import axis_delays, with_units, written_effects
from sysid.plant import compile_plant
from sysid.progress import Progress, part
from sysid.registry import Registry
from sysid.signals import split_signal

#: Values of fields of a :class:`~sysid.gap.result.GapResult`.
Fields = Mapping[str, Any]
#: Why a part is missing in the answer that is kept before it.
NOT_REACHED = "the command ended before it"
#: The name of the result itself, where it could not be stored.
STORED_RESULT = "stored result"
_PACKAGE = Path(__file__).parents[1]


def completed(
    answer: GapResult, parts: Mapping[str, Callable[[], Fields]], keep: Callable[[GapResult], object] | None = None
) -> GapResult:
    """The answer with the parts that could be computed, in their order.

    Args:
        parts: name of each, and what gives its fields of the result.
        keep: stores a result; called with the answer, and with the whole.
    """
    result, missing = answer, dict.fromkeys(parts, NOT_REACHED)

    def listed() -> GapResult:
        return replace(result, missing=tuple(Missing(*item) for item in missing.items()))

    def kept() -> None:
        if keep is None:
            return
        try:
            keep(listed())
        except SysidError as error:
            missing[STORED_RESULT] = str(error)

    kept()
    missing.pop(STORED_RESULT, None)
    for name, compute in parts.items():
        try:
            result = replace(result, **compute())
        except Exception as error:  # whatever it is: the answer does not depend on it
            missing[name] = reason(error)
        else:
            del missing[name]
    kept()
    return listed()


def reason(error: Exception) -> str:
    """The sentence of an error; of one that is not raised on purpose, with its place in the code."""
    if isinstance(error, SysidError):
        return str(error)
    own = [frame for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename).is_relative_to(_PACKAGE)]
    place = f" ({Path(own[-1].filename).relative_to(_PACKAGE.parent)}, line {own[-1].lineno})" if own else ""
    return f"{type(error).__name__}: {str(error).strip() or 'no text'}{place}"


@dataclass
class Following:
    """What follows the decision on one study.

    Args:
        proof: of the decision; its errors are empty until they are measured.
        shown: excitation of every candidate; ``lacking``: it is not sufficient at a stage above its noise floor.
        above: whether a stage that was only localised is above its noise floor.
        notes: of the decision; those of the parts are added.
        version: of the stored repair; empty without one.
    """

    study: steps.Study
    proof: steps.Proof
    shown: Sequence[Excitation]
    lacking: bool
    above: bool
    notes: tuple[str, ...]
    report: Progress
    version: str = field(default="", init=False)

    def carry(self) -> Fields:
        """Residual networks for what is unnamed."""
        before = self.proof.outcome
        outcome = steps.with_residual_networks(self.study, before, part(self.report, 0.75, 0.8))
        self.proof = replace(self.proof, outcome=outcome)
        return {"carried": tuple(outcome.carried), **self._noted(outcome.notes[len(before.notes) :])}

    def errors(self) -> Fields:
        """Errors on held-out recordings before and after the repair."""
        self.report(0.8, "proving on held-out recordings")
        self.proof = steps.measure(self.study, self.proof.outcome)
        proof, verdict = self.proof, self.verdict
        fields = {"gap": proof.gap, "stage_gap": proof.stage_gap, "traces": proof.traces, "agreement": proof.agreement}
        fields |= {"responses": proof.responses}
        known = {split_signal(item.target)[0] or item.target for item in proof.outcome.unnamed}
        runs = _unnamed_runs(proof.agreement, known) if verdict == "unnamed" and not self.above else ()
        return {**fields, "verdict": verdict, "unnamed": (*proof.outcome.unnamed, *runs)}

    @property
    def verdict(self) -> Verdict:
        """The verdict, by what is decided and measured until now."""
        outcome = self.proof.outcome
        unnamed = bool(outcome.unnamed) or self.above
        return verdict_of(bool(outcome.named), bool(outcome.ties), unnamed, self.lacking, self.proof.agreement)

    def world(self) -> Fields:
        """The same in the PyBullet world."""
        self._check_measured()
        self.proof = steps.in_world(self.study, self.proof, part(self.report, 0.8, 0.85))
        return {"world_gap": self.proof.world}

    def written(self) -> Fields:
        """What the repair changes in the plant."""
        case, outcome = self.study.case, self.proof.outcome
        changed = written_effects(
            case.plant, outcome.repaired, outcome.named, outcome.ties, outcome.near_misses, outcome.refused
        )
        return {
            "written": tuple(with_units(changed, case.dataset)),
            "delays": axis_delays(case.plant, outcome.repaired),
            "machine_diff": steps.machine_diff(self.study, self.proof),
        }

    @property
    def repairs(self) -> bool:
        """Whether the decision changes the plant under test."""
        return self.proof.outcome.repaired is not self.study.case.plant

    def store(self, registry: Registry) -> Fields:
        """The repair as a version; none where nothing is repaired."""
        self._check_measured()
        if self.repairs:
            self.version = steps.store(self.study, self.proof, registry)
        return {"plant_after": self.version}

    def promote(self, registry: Registry) -> Fields:
        """Whether the stored repair is promoted."""
        if not self.repairs:
            return {}
        if not self.version:
            raise ExcitationError(self.study.case.dataset.reference, "no stored repair", "one that can be promoted")
        return {"promotion": steps.promote(self.study, self.proof, registry, self.version)}

    def plan(self, planning: Planning) -> Fields:
        """Recordings that would resolve open hypotheses."""
        self.report(0.85, "planning the next experiment")
        case, outcome = self.study.case, self.proof.outcome
        hypotheses = open_hypotheses(case, list(self.study.stages), outcome)
        planned = itertools.count()

        def on_hypothesis(text: str) -> None:
            self.report(0.85 + 0.15 * min(1.0, next(planned) / max(1, len(hypotheses))), f"planning: {text}")

        proposal = propose(case, outcome.repaired, hypotheses, planning, on_hypothesis)
        return {"experiments": proposal.experiments, **self._noted(proposal.notes)}

    def next_recordings(self) -> Fields:
        """Recordings that would separate ties and excite effects, in words; none where simulation and machine agree."""
        if self.verdict == "no_gap":
            return {}
        return {"next_experiment": steps.next_experiment(self.study, self.proof, self.shown)}

    def shares(self) -> Fields:
        """Contribution of each stage to the error at the ends of the chain."""
        case = self.study.case
        return {"shares": shares_of(compile_plant(case.plant), case.split.seen)}

    def maps(self) -> Fields:
        """Maps over the fit and selection recordings, stage by stage."""
        case, repaired = self.study.case, self.proof.outcome.repaired
        machine, units = case.plant.machine, case.dataset.units
        vector = repaired.vector() if self.repairs else None
        of_stages = (maps_of(s.problem, case.theta, s.split.seen, s.sigma, machine, units, vector) for s in self.study.stages)
        return {"maps": tuple(item for maps in of_stages for item in maps)}

    def _noted(self, notes: Sequence[str]) -> Fields:
        self.notes = (*self.notes, *notes)
        return {"notes": self.notes}

    def _check_measured(self) -> None:
        """Raises ExcitationError: the errors on held-out recordings are missing."""
        if not self.proof.gap.before:
            raise ExcitationError(self.study.case.dataset.reference, "no errors on held-out recordings", "those of the repair")


def _unnamed_runs(agreement: Sequence[Agreement], known: Collection[str]) -> Iterator[Unnamed]:
    """The errors of free runs of which no stage has one: the largest of each axis and point that is not ``known``."""
    worst: dict[str, Agreement] = {}
    for item in sorted((item for item in agreement if item.remains), key=lambda item: -item.floors(item.after)):
        worst.setdefault(split_signal(item.signal)[0], item)
    for owner, item in worst.items():
        if owner not in known:
            form = "each stage agrees at its measured input; what is left of their errors adds up in the run from the commands"
            yield Unnamed("free_run", item.signal, item.after, "nothing that was measured", form)
