"""The gap of a stored dataset, and what can be done with its result."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import pandas as pd
from markupsafe import escape

from sysid.datasets import Dataset
from sysid.datasets.checks.finding import Finding, not_accepted, refuse_severe
from sysid.datasets.checks.roles import check_needs
from sysid.datasets.checks.run import check_plausibility
from sysid.display import NOTHING, percent, quantity
from sysid.effects import inertial_error
from sysid.errors import StoreError
from sysid.figures import Table, times
from sysid.foreign import visible
from sysid.front.drawing import Drawing, by_error, drawn_map, drawn_traces, worst_signal
from sysid.front.place import Place, dataset_in, shown
from sysid.front.place import open as opened
from sysid.gap import GapResult as GapValues
from sysid.gap import Simulator
from sysid.gap import find_gap as find_gap_in
from sysid.gap.experiment import Planning
from sysid.gap.result import Gap, NamedEffect, WrittenEffect
from sysid.gap.search_tasks import search_tasks
from sysid.gap.stage_search import Forms
from sysid.gap.statement import Verdict, missing_sentences
from sysid.plant import Plant
from sysid.reports.pages import filled
from sysid.reports.result_figures import error_table, parameters_of, signal_errors, unnamed_sentence
from sysid.reports.words import effect_place, tie_text
from sysid.workspace import Workspace

if TYPE_CHECKING:
    from sysid.execution import Executor
    from sysid.export.export import Export
    from sysid.progress import Progress

#: Columns of the text, and rows of its table of errors.
WIDTH, ERRORS = 80, 6
KINDS = {"named": "named", "tied": "one of a tie", "adjusted": "no name"}
#: What is tested: a plant, a simulator, the reference of a stored plant, or what gives one for the dataset.
Tested = Plant | Simulator | str | Callable[[Dataset], Plant | Simulator]
OnFindings = Callable[[Sequence[Finding], Sequence[Finding]], None]


def find_gap(
    dataset: Dataset | str | None = None,
    plant: Tested | None = None,
    workspace: Place = None,
    *,
    add: bool | None = None,
    world: bool | None = None,
    localise: bool = False,
    carry: bool = False,
    forms: Forms = "all",
    accept: Sequence[str] = (),
    on_findings: OnFindings | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> GapResult:
    """Name the effects that a simulation lacks, prove them on held-out recordings, and store result and repaired simulation.

    Args:
        dataset: of the workspace, or its reference; None: the only one.
        plant: what is tested; None: the nominal plant of the dataset's ``machine.toml``.
        workspace: that of the dataset, see :func:`sysid.open`.
        add: store the repaired plant as a new version, and promote it if the proof passes; None: unless a simulator is tested.
        world: run the proof in the PyBullet world as well; None: with ``add``, where PyBullet is installed.
        localise: only locate the gap; nothing is stored.
        carry: fit bounded residual networks to unnamed errors.
        forms: ``simple`` tests every effect in its simplest form only.
        accept: keys of severe findings in the recordings, or globs of them, with which the search continues.
        on_findings: called before the search with the findings that stop it, and with all.
        executor: searches stages in other processes.
        progress: called with the share done and a text; by default a bar is shown.

    Raises:
        InputError: severe findings in the recordings that are not accepted, or a simulator that fails.
        ExcitationError: no stage is measured at both ends, or a role has no recording.
        StoreError: no such dataset or plant in the workspace.
    """
    place = opened(workspace)
    data = dataset_in(place, dataset)
    check_needs(data)
    findings = check_plausibility(data)
    left = not_accepted(findings, accept)
    if on_findings is not None:
        on_findings(left, findings)
    refuse_severe(left, (), data.reference)
    with shown(progress, "gap") as report:
        report(0.0, "loading")
        tested = place.plant(data, plant) if plant is None or isinstance(plant, str) else plant
        tested = tested if isinstance(tested, Plant | Simulator) else tested(data)
        values = find_gap_in(
            data,
            tested,
            registry=place.models,
            add=(isinstance(tested, Plant) and not localise) if add is None else add,
            world=world,
            localise_only=localise,
            carry=carry,
            forms=forms,
            progress=report,
            planning=Planning(),
            tasks=search_tasks(str(place.location), executor) if executor is not None and isinstance(tested, Plant) else None,
            keep=None if localise else lambda values: place.keep_gap(data, values),
        )
    return GapResult(values, data, place, tested, tuple(findings))


@dataclass(frozen=True)
class RepairedPlant:
    """A stored repaired simulation."""

    plant: Plant
    dataset: Dataset = field(repr=False)
    workspace: Workspace = field(repr=False)

    @property
    def reference(self) -> str:
        """``name@version``."""
        return self.plant.reference

    def export(self, target: str, out: str | os.PathLike[str]) -> Export:
        """Write it for another simulator: :func:`sysid.export`."""
        from sysid.front.files import export

        return export(self.reference, target, out, dataset=self.dataset, workspace=self.workspace)

    def __repr__(self) -> str:
        return f"RepairedPlant({self.reference})"


@dataclass(frozen=True, repr=False)
class GapResult:
    """What :func:`find_gap` has found; it prints as a short table.

    Args:
        result: everything, as ``docs/result.md`` describes it.
        tested: the simulation under test.
        findings: what is implausible in the recordings.
    """

    result: GapValues
    dataset: Dataset
    workspace: Workspace
    tested: Plant | Simulator
    findings: tuple[Finding, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """``named``, ``no_gap``, ``ambiguous``, ``unnamed`` or ``insufficient_excitation``."""
        return self.result.verdict

    @property
    def effects(self) -> tuple[NamedEffect, ...]:
        """The named effects, with parameters and 95 % intervals [SI]."""
        return self.result.effects

    @property
    def repaired(self) -> RepairedPlant:
        """The repaired simulation.

        Raises:
            StoreError: none is stored.
        """
        if not self.result.plant_after:
            remedy = "find_gap(…, add=True) stores it, where an effect is named."
            raise StoreError(f"gap of {self.dataset.reference}", "no repaired simulation is stored", "one", remedy)
        return RepairedPlant(self.workspace.plant(self.dataset, self.result.plant_after), self.dataset, self.workspace)

    def table(self) -> pd.DataFrame:
        """A row for each parameter that the repair writes, in SI units, with its 95 % interval; ``share``: of the gap."""
        columns = ["effect", "target", "parameter", "value", "low", "high", "unit", "share", "kind"]
        rows = [
            (item.name, item.target, key, value, *item.interval95.get(key, (None, None)), item.units.get(key, ""),
             item.gap_share, item.kind)
            for item in self.result.written
            for key, value in item.parameters.items()
        ]  # fmt: skip
        return pd.DataFrame(rows, columns=columns)

    def errors(self, stages: bool = False) -> pd.DataFrame:
        """Held-out RMSE [SI] of each signal before and after the repair, its noise floor, and the closed share.

        Args:
            stages: each stage driven by its measured input; by default the free run from the commands.
        """
        figures = signal_errors(self.result.stage_gap if stages else self.result.gap, self.dataset.units)
        rows = [(each.name, each.before, each.after, each.noise_floor, each.closed, each.unit) for each in figures]
        columns = ["signal", "before", "after", "noise floor", "closed", "unit"]
        return pd.DataFrame(rows, columns=columns).set_index("signal")

    def plot(self, signal: str | None = None, over: str | None = None, recording: str | None = None) -> Drawing:
        """Draw a signal of a held-out recording: measured, and simulated before and after the repair.

        Args:
            signal: by default the one with the largest error in noise floors.
            over: draw the error map of the signal over this variable instead, such as ``boom.command``.
            recording: held out; default: the first.

        Raises:
            SettingsError: no such signal, variable or recording in the result.
        """
        signal = signal or worst_signal(self.result)
        if over is not None:
            return drawn_map(self.result, signal, over)
        return drawn_traces(self.result, signal, recording, self.dataset.units)

    def __repr__(self) -> str:
        lines = [part for line in self._lines() for part in textwrap.wrap(visible(line, len(line)), WIDTH)]
        for found in self._tables():
            lines += (line.rstrip() for line in found.text(WIDTH)[0])
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        lines = [f"<p>{escape(line)}</p>" for line in self._lines()]
        tables = [filled("table.html", table=found, look="") for found in self._tables()]
        drawing = [self.plot().svg] if self.result.traces else []
        return "\n".join([*lines, *tables, *drawing])

    def _lines(self) -> list[str]:
        lines = [f"{self.dataset.reference}: {self.result.headline}  [{self.verdict}, {self.result.seconds:.1f} s]"]
        if self.result.plant_after:
            lines.append(f"Repaired simulation: {self.result.plant_after}")
        if self.findings:
            lines.append(f"Implausible in the recordings: {len(self.findings)}, see findings")
        machine = self.dataset.machine
        lines += [f"Cannot be distinguished: {tie_text(tie, machine)}" for tie in self.result.ambiguous]
        lines += [unnamed_sentence(item, machine) for item in self.result.unnamed]
        if len(self.result.gap.before) > ERRORS:
            lines.append(f"Below: the {ERRORS} largest errors of {len(self.result.gap.before)}; errors() has all")
        return [*lines, *missing_sentences(self.result.missing)]

    def _tables(self) -> list[Table]:
        written = written_table(self.result, self.dataset)
        if all(item.kind == "named" for item in self.result.written):
            written = replace(written, header=written.header[:-1], rows=[row[:-1] for row in written.rows])
        found = [written] if self.result.written else []
        if self.result.settings.get("localise_only"):
            found.append(localised_table(self.result, self.dataset))
        elif self.result.gap.before:
            found.append(error_table(_largest(self.result.gap), self.dataset.units))
        return found


def _largest(gap: Gap) -> Gap:
    """The signals with the largest errors before the repair, in noise floors."""
    worst = by_error(gap)[:ERRORS]
    return Gap(*({name: figures[name] for name in worst} for figures in (gap.before, gap.after, gap.noise_floor)))


def localised_table(values: GapValues, dataset: Dataset) -> Table:
    """The error of every stage output at its measured input, the largest in noise floors first, and in the free run."""
    rows = []
    for item in sorted(values.localised, key=lambda item: -item.stage_rmse / max(item.noise_floor, 1e-300)):
        unit = dataset.units.get(item.signal)
        error, floor, chain = (quantity(value, unit) for value in (item.stage_rmse, item.noise_floor, item.free_run_rmse))
        rows.append((item.stage, item.signal, error, floor, times(item.stage_rmse, item.noise_floor), chain))
    return Table(("stage", "signal", "error", "noise floor", "times", "whole chain"), rows, (2, 3, 4, 5))


def written_table(values: GapValues, dataset: Dataset) -> Table:
    """A row for every parameter that the repair writes into the plant: named, adjusted without a name, changed.

    Small errors of the inertia of links, which are adjusted together, are left out.
    """
    machine = dataset.machine
    rows: list[tuple[str, ...]] = []
    for item in values.written:
        if item.name == inertial_error.EFFECT.name:
            continue
        share = percent(item.gap_share) if item.gap_share is not None else NOTHING
        heads = [(effect_place(item.name, item.target, machine), share, KINDS[item.kind])]
        for figure in parameters_of(
            item.name, item.target, item.parameters, machine, dataset.units, item.interval95, item.before
        ):
            title, part, kind = heads.pop() if heads else ("", "", "")
            known = f" (was {figure.before_text})" if figure.before is not None else ""
            rows.append((title, f"{figure.label} {figure.text}{known}", figure.interval, part, kind))
        rows += [("", f"{key.replace('_', ' ')} not determined", "", "", "") for key in _undetermined(values, item)]
    return Table(("effect", "value", "95 % interval", "share", "row"), rows, right=(3,))


def _undetermined(values: GapValues, item: WrittenEffect) -> list[str]:
    key = (item.name, item.target, item.side)
    return [name for each in values.effects if (each.name, each.target, each.side) == key for name in each.undetermined]
