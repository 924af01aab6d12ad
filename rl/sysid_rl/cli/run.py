"""``sysid run RUNNER.toml``: a task on a machine, supervised and recorded."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sysid.cli import output
from sysid.cli.interruption import leave_interrupts
from sysid.cli.output import Printer, json_option
from sysid_rl.cli.streams import closed_stdout_ignored, open_standard_streams

if TYPE_CHECKING:
    from sysid.errors import StorageError
    from sysid_rl.run.assemble import Assembly
    from sysid_rl.run.dry_run import RangeRecorder
    from sysid_rl.run.flight_log import FlightLog
    from sysid_rl.run.modes.commission import Commission
    from sysid_rl.run.outcome import RunOutcome


@click.command()
@click.argument("recipe", type=click.Path(path_type=Path), metavar="RUNNER.toml")
@click.option("--dry-run", is_flag=True, help="Run all checks and the simulated machine; nothing is opened.")
@click.option("--commission", is_flag=True, help="First motion of a machine: one axis at a time, compared with the plant.")
@click.option("--unattended", is_flag=True, help="Arm and hold the dead-man switch by program; only on simulated machines.")
@click.option("--seconds", type=click.FloatRange(0.1), default=None, help="Maximum duration of the run [s].")
@click.option("--view", is_flag=True, help="Show the run in Rerun with a delay of one second.")
@click.option("--log", "log", type=click.Path(file_okay=False, path_type=Path), default=None, help="Folder of recordings.")
@json_option
@click.pass_context
def run(
    ctx: click.Context,
    recipe: Path,
    dry_run: bool,
    commission: bool,
    unattended: bool,
    seconds: float | None,
    view: bool,
    log: Path | None,
    out: Printer,
) -> None:
    """Run a recipe on its machine: track, hold, collect, replay, watch.

    Commands at the terminal: arm (then hold the dead-man switch to start), stop, reset (after a fault), quit, abort. Ctrl-C,
    other termination signals and a closed terminal stop within the limits and quit; a second signal aborts with neutral valves
    at once. Exit status 1 if the run ended in a fault.
    """
    from dataclasses import replace

    from sysid.errors import SettingsError, SysidError
    from sysid.workspace import open_workspace
    from sysid_rl.run.assemble import assemble
    from sysid_rl.run.clock import SECOND
    from sysid_rl.run.commissioning import keep_record, require_commissioned
    from sysid_rl.run.dry_run import RangeRecorder, run_dry
    from sysid_rl.run.flight_log import FlightLog, provenance
    from sysid_rl.run.modes.commission import Commission
    from sysid_rl.run.operator import Interruptible, Operator, Unattended
    from sysid_rl.run.recipe import load_runner
    from sysid_rl.run.run_record import EventRecorder, Recorders, RunRecord
    from sysid_rl.run.terminal import Console, Terminal, redirected_output
    from sysid_rl.run.transport import Settable
    from sysid_rl.run.transports import connect

    open_standard_streams()
    settings = load_runner(recipe)
    if commission:
        settings = replace(settings, mode="commission")
    if seconds is not None:
        settings = replace(settings, loop=replace(settings.loop, seconds=seconds))
    workspace = open_workspace(ctx.obj)
    registry = workspace.models
    assembly = assemble(settings, registry, recipe)
    with closed_stdout_ignored():
        _print_setup(out, assembly)
    line = connect(assembly, registry)
    for text in line.remarks:
        out.line(f"  note: {text}")
    if dry_run:
        found = run_dry(assembly, seconds or 60.0)
        out.line(f"Dry run of {found.seconds:.0f} s on the simulated machine; nothing was opened or sent.")
        _print_outcome(out, assembly, found.outcome, found.ranges)
        out.json({"schema": 1, "dry_run": True, **_figures(assembly, found.outcome, found.ranges)})
        return
    leave_interrupts()  # from here on the machine decides how a run stops
    transport = line.transport
    program = unattended or settings.in_process
    if program and not (line.simulated and isinstance(transport, Settable)):
        raise SettingsError("--unattended", "a real machine", "an operator: run without --unattended")
    ranges = RangeRecorder(len(assembly.machine.axes), round(SECOND * assembly.dt))
    events = EventRecorder()
    recorders = Recorders(ranges, events)
    console = Console()
    operator: Operator = Unattended(transport) if program and isinstance(transport, Settable) else Terminal(console)
    files = {"recipe": recipe, "machine": assembly.machine_file}
    versions = {version.reference: version.digest for version in assembly.loaded.versions}
    words = provenance(files, versions) | {"run": {"name": settings.name, "mode": settings.mode}}
    folder = log or Path(settings.log.folder)
    kind: Any = "poses" if settings.mode == "collect" else "motion"
    with contextlib.closing(console), Interruptible(operator) as person, redirected_output(console):
        loop = assembly.loop(transport, recorders, person)
        mode = loop.mode
        if line.wired and mode.moves and not isinstance(mode, Commission):
            out.line(f"  {require_commissioned(assembly, recipe)}")
        flight = FlightLog(
            folder, assembly.machine_file, transport.axes, transport.signals, words, kind=kind, clock_ns=transport.now_ns()
        )
        recorders.log = flight
        record = RunRecord(workspace.root, flight.path, _about(assembly))
        unrecorded = _recorded(record.begin)
        try:
            if view:
                show_log(flight.path)
            outcome = loop.run(mode.watch if isinstance(mode, Commission) else None)
        finally:
            ended = loop.outcome
            flight.add_metadata("end", {"ended": ended.ended, "state": ended.state, "why": ended.why, "error": ended.error})
            unwritten = _closed(flight)
    if console.lost:
        outcome.notes.append(f"{console.lost} lines could not be printed at the terminal")
    figures = _figures(assembly, outcome, ranges) | {"lost_cycles": flight.lost}
    unrecorded = _recorded(lambda: record.end(figures, events)) or unrecorded
    if unrecorded:
        outcome.notes.append(unrecorded)
    failed: Exception | None = None
    kept: Path | None = None
    try:
        if isinstance(mode, Commission):
            kept = keep_record(assembly, mode, recipe, str(flight.path))
        with closed_stdout_ignored(out.json_file == "-"):
            out.json({"schema": 1, "dry_run": False, "log": str(flight.path), **figures})
    except (OSError, SysidError) as error:  # raised after the outcome is printed
        failed = error
    with closed_stdout_ignored():
        _print_outcome(out, assembly, outcome, ranges)
        if isinstance(mode, Commission) and kept is not None:
            _commissioned(out, mode, kept)
        out.line(f"{flight.path}   (a recording: {output.command('ingest', folder, '--recipe', folder / 'recipe.toml')})")
    if missing := unwritten or failed:
        raise missing
    if outcome.ended == "fault" or (isinstance(mode, Commission) and not mode.passed):
        ctx.exit(1)


def _commissioned(out: Printer, mode: Commission, record: Path) -> None:
    """Results of a commissioning."""
    rows = [
        (f"{item.axis} {'+' if item.direction > 0 else '−'}", f"{item.command:.2f}", f"{1e3 * item.tip:.1f} mm",
         *((f"{item.gain:.2f}", f"{item.dead_band:+.2f}", f"{1e3 * item.delay:.0f} ms") if item.judged else ("", "", "")),
         item.wrong or "as planned")
        for item in mode.strokes
    ]  # fmt: skip
    out.table(("stroke", "command", "boom tip", "gain / plant", "dead-band", "delay", ""), rows, right=range(1, 6))
    for signal, (what, off) in mode.zeros.items():
        out.line(f"  zero of {signal}: {1e3 * off:.1f} mm at the boom tip, checked by {what}")
    for signal in mode.driven:
        if signal not in mode.zeros:
            out.line(f"  zero of {signal}: NOT CHECKED; accepted by the recipe")
    out.line(f"{record}   ({'commissioned' if mode.passed else 'NOT commissioned'})")


def show_log(log: Path) -> None:
    """Start a viewer that follows the log, in a separate process that Ctrl-C does not end."""
    import subprocess

    from sysid.children import child_environment, python_command

    command = python_command("-m", "sysid.cli", "view", "--", str(log))
    process = subprocess.Popen(command, env=child_environment(), start_new_session=True)
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, process.pid, 10)


def _closed(flight: FlightLog) -> StorageError | None:
    """Close the log; returns its error, which is raised after the outcome is printed."""
    from sysid.errors import StorageError

    try:
        flight.close()
    except StorageError as error:
        return error
    return None


def _recorded(write: Callable[[], None]) -> str:
    """Write the record of the run; why that is impossible, for a note: it does not stop a run."""
    from sysid.errors import SysidError

    try:
        write()
    except (OSError, SysidError) as error:
        return f"the run is not listed in the workspace: {error}"
    return ""


def _print_setup(out: Printer, assembly: Assembly) -> None:
    recipe, loaded, limits = assembly.recipe, assembly.loaded, assembly.limits
    out.line(f"{recipe.name}: {recipe.mode} on {assembly.machine.name} at {assembly.machine.rate_hz:g} Hz, "
             f"through {recipe.transport['kind']}")  # fmt: skip
    accepted = recipe.versions.unpromoted
    for version in loaded.versions:
        other = "accepted by the recipe" if version.reference in accepted else "a machine would refuse it"
        mark = "promoted" if "champion" in version.aliases else f"NOT promoted, {other}"
        out.line(f"  {version.kind:<9}{version.reference:<28}{version.digest[:12]}  {mark}")
    policy = recipe.versions.policy if loaded.policy is None else "the policy"
    out.line(f"  setpoints by {policy}, targets {1e3 * assembly.lookahead:.0f} ms ahead; fallback: {recipe.loop.fallback}")
    for text in loaded.remarks:
        out.line(f"  note: {text}")
    for check, reason in recipe.checks.without.items():
        out.line(f"  WITHOUT the check {check}: {reason}")
    rows = []
    axes = zip(
        assembly.machine.axis_names, limits.low, limits.high, limits.speed, limits.acceleration, limits.command, strict=True
    )
    for name, low, high, speed, acceleration, command in axes:
        rows.append((name, f"{low:.3f} … {high:.3f}", f"{speed:.3f}", f"{acceleration:.3f}", f"{command:g}"))
    out.table(("axis", "position", "speed", "acceleration", "command"), rows, right=range(1, 5))
    if limits.fenced:
        ends = zip("xyz", limits.fence_low, limits.fence_high, strict=True)
        out.line("fence of the end effector: " + ", ".join(f"{a} {low:.3f} … {high:.3f}" for a, low, high in ends) + " m")
    else:
        out.line("no fence: the joint limits alone bound the end effector ([limits.fence] adds one)")


def _print_outcome(out: Printer, assembly: Assembly, outcome: RunOutcome, ranges: RangeRecorder) -> None:
    if ranges.moving:
        rows = [
            (name, f"{low:.3f} … {high:.3f}", f"{command:.2f}")
            for name, low, high, command in zip(assembly.machine.axis_names, *ranges.joints, ranges.commands, strict=True)
        ]
        out.table(("axis", "range", "largest command"), rows, right=(1, 2))
        ends = ", ".join(f"{a} {low:.3f} … {high:.3f}" for a, low, high in zip("xyz", *ranges.ee, strict=True))
        out.line(f"end effector: {ends} m; {ranges.moving} cycles in motion: "
                 + ", ".join(f"{phase} {count}" for phase, count in ranges.phases.items()))  # fmt: skip
    if ranges.rmse is not None:
        rmse, worst = (" / ".join(f"{1e3 * value:.2f}" for value in values) for values in (ranges.rmse, ranges.worst))
        far = {norm: f"{1e3 * value:.2f}" for norm, value in ranges.distance.items()}
        out.line(f"tracking error of {_tracked(assembly)}, over {ranges.tracked} cycles: distance mean {far['mean']}, "
                 f"RMSE {far['rmse']}, max {far['max']} mm; x / y / z: RMSE {rmse}, max {worst} mm")  # fmt: skip
    late, spent = outcome.lateness, outcome.latency
    out.line(f"{outcome.cycles} cycles, {outcome.missed} deadlines missed; lateness p50 {late.percentile(0.5):.0f}, "
             f"p99 {late.percentile(0.99):.0f}, max {late.largest_us:.0f} µs; a cycle took p50 {spent.percentile(0.5):.0f}, "
             f"p99 {spent.percentile(0.99):.0f}, max {spent.largest_us:.0f} µs")  # fmt: skip
    for check, count in outcome.verdicts.most_common():
        out.line(f"  {check} violated in {count} cycles")
    for text in outcome.notes:
        out.line(f"  {text}")
    out.line(f"ended: {outcome.ended}; state {outcome.state}" + (f": {outcome.why}" if outcome.why else ""))


def _tracked(assembly: Assembly) -> str:
    """Path, source of setpoints, transport, and source of the end-effector position."""
    recipe, forward = assembly.recipe, next(item.reference for item in assembly.loaded.versions if item.kind == "forward")
    path = assembly.tracking.path.name if assembly.tracking is not None else "its target"
    setting = f"{path} by {recipe.versions.policy} through {recipe.transport['kind']}"
    return f"{setting}, measured by the machine's sensors and {forward} (including their errors)"


def _about(assembly: Assembly) -> dict[str, Any]:
    """What is known before the run."""
    return {
        "name": assembly.recipe.name,
        "mode": assembly.recipe.mode,
        "machine": assembly.machine.name,
        "transport": assembly.recipe.transport["kind"],
        "versions": {version.reference: version.digest for version in assembly.loaded.versions},
    }


def _figures(assembly: Assembly, outcome: RunOutcome, ranges: RangeRecorder) -> dict[str, Any]:
    return {
        **_about(assembly),
        "ended": outcome.ended,
        "state": outcome.state,
        "why": outcome.why,
        "turns": outcome.cycles,
        "missed_deadlines": outcome.missed,
        "lateness_us": outcome.lateness.to_json(),
        "turn_us": outcome.latency.to_json(),
        "verdicts": dict(outcome.verdicts),
        "notes": outcome.notes,
        "joints": {"low": ranges.joints[0], "high": ranges.joints[1]} if ranges.moving else None,
        "ee": {"low": ranges.ee[0], "high": ranges.ee[1]} if ranges.moving else None,
        "error_of": _tracked(assembly) if ranges.rmse is not None else None,
        "distance_mm": {norm: 1e3 * value for norm, value in ranges.distance.items()} or None,
        "rmse_mm": 1e3 * ranges.rmse if ranges.rmse is not None else None,
        "max_mm": 1e3 * ranges.worst if ranges.rmse is not None else None,
        "distance_by_second_mm": [(second, 1e3 * far) for second, far in ranges.by_second.items()],
    }
