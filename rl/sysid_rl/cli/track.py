"""``sysid track POLICY``: tracking error of a policy or inverse kinematics on a path."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sysid.cli.output import FOLDER, Printer, json_option, progress_bar, rerun_command, write_json

if TYPE_CHECKING:
    from sysid.networks.policy import PolicyNetwork
    from sysid.workspace import Workspace
    from sysid_rl.train.environment import Policy
    from sysid_rl.train.tracking import TrackingResult
    from sysid_rl.train.tracking_task import TrackingTask


@click.command()
@click.argument("policy")
@click.option("--path", "path", default="helix", show_default=True, metavar="helix|circle|FILE", help="FILE: CSV with t,x,y,z.")
@click.option("--plant", default=None, metavar="PLANT[@VERSION]", help="Plant; else the policy's, or the only one.")
@click.option("--forward", default=None, metavar="MODEL[@VERSION]", help="Forward model; else the policy's, or the plant's.")
@click.option("--full", is_flag=True, help="Through cylinder controller, valves and plant; else joints follow at once.")
@click.option("--lookahead", type=click.FloatRange(0.0, 5.0), default=None, metavar="S", help="Use targets S seconds ahead.")
@click.option(
    "--baseline", "baselines", multiple=True, metavar="ik|ik-lookahead", help="Also evaluate this baseline; may be repeated."
)
@click.option(
    "--candidates",
    type=click.IntRange(min=1),
    default=None,
    metavar="N",
    help="Also evaluate the best of N setpoints around the policy's, by the forward model.",
)
@click.option(
    "--scatter",
    type=click.FloatRange(0.0, 1.0),
    default=0.01,
    show_default=True,
    help="Of the candidates, in half ranges of the joints.",
)
@click.option("--centre", type=(float, float, float), default=None, metavar="X Y Z", help="Of helix or circle [m].")
@click.option("--untuned", is_flag=True, help="With a plain proportional controller below (--full), for comparison.")
@click.option("--out", "place", type=FOLDER, metavar="DIR", help="Output folder.")
@json_option
@click.pass_obj
def track(
    location: str,
    policy: str,
    path: str,
    plant: str | None,
    forward: str | None,
    full: bool,
    lookahead: float | None,
    baselines: tuple[str, ...],
    candidates: int | None,
    scatter: float,
    centre: tuple[float, float, float] | None,
    untuned: bool,
    place: Path | None,
    out: Printer,
) -> None:
    """Follow a path and report the tracking error of the end effector, sampled at the end of each step.

    POLICY is a policy version, or a baseline: ik (bounded least-squares inverse kinematics on calibrated kinematics) or
    ik-lookahead (the same, with targets ahead by the dead time of the machine).
    """
    from sysid.errors import SettingsError
    from sysid.names import check_file_name
    from sysid.registry.policy import load_policy
    from sysid.workspace import open_workspace
    from sysid_rl.control import proportional_tuning
    from sysid_rl.train.policy import CandidateSearchPolicy
    from sysid_rl.train.record import write_results
    from sysid_rl.train.tracking_task import BASELINES, TruncatedObservationPolicy, plan_tracking
    from sysid_rl.train.versions import load_versions

    workspace = open_workspace(location)
    network, lineage = None, {}
    if policy not in BASELINES:
        version = workspace.models.load(policy)
        network, lineage, policy = load_policy(version), dict(version.lineage), version.reference
        full = full or network.full
    plant = plant or lineage.get("plant") or _only(workspace, "plant")
    forward = forward or lineage.get("forward") or _forward_for(workspace, plant)
    simulation, model = load_versions(workspace.models, plant, forward)
    if candidates is not None and network is None:
        raise SettingsError("--candidates", f"with {policy}", "a policy version: candidates cannot improve inverse kinematics")
    if candidates is not None and network is not None and network.residual is not None:
        raise SettingsError("--candidates", f"with {policy}", "a policy that sets joints: this one offsets inverse kinematics")
    if untuned and not full:
        raise SettingsError("--untuned", "without --full", "--full, which uses a controller")
    with progress_bar("track") as progress:
        progress(0.0, f"placing {path}")
        course = plan_tracking(
            simulation, model, path, full=full, centre=centre, tuning=proportional_tuning(simulation) if untuned else None
        )
        progress(0.3, policy)
        runs = [
            course.baseline(policy) if network is None else course.run(policy, _on_machine(network, course), lookahead or 0.0)
        ]
        if candidates is not None and network is not None:
            progress(0.4, f"{candidates} candidates")
            searching = TruncatedObservationPolicy(CandidateSearchPolicy(network, model, candidates, scatter))
            runs.append(course.run(f"{policy} and {candidates} candidates", searching, lookahead or 0.0))
        for number, name in enumerate(name for name in dict.fromkeys(baselines) if name != policy):
            progress(0.5 + 0.4 * number / len(baselines), name)
            runs.append(course.baseline(name))
        kind = "full" if full else "kinematic"
        name = check_file_name(f"{policy.replace('@', '-')}-{course.path.name}-{kind}", "path")
        folder = place or workspace.root.make(f"tracks/{name}")
        files = write_results(folder, simulation.machine, runs)
    _show(out, runs)
    how = "cylinder controller, valves and plant" if full else "joints follow at once (the paper's setting)"
    begin = course.path.points[0]
    out.line(f"{course.path.name}: {len(runs[0].time)} steps at {course.path.rate_hz:g} Hz, up to {course.path.speed:.3f} m/s,")
    out.line(f"from ({begin[0]:.3f}, {begin[1]:.3f}, {begin[2]:.3f}) m. {simulation.reference}, {how}.")
    if full:
        axis, share = max(course.demand.items(), key=lambda item: item[1], default=("", 0.0))
        much = ", which it cannot reach" if share > 1.0 else ""
        out.line(f"The axis with the highest demand is {axis}: {100.0 * share:.0f} % of its maximum speed{much}.")
    out.line(f"Inverse kinematics on the geometry of the {course.kinematics}; forward model {forward}.")
    out.line(f"{folder}   (view: {rerun_command(files['rerun'])})")
    values: dict[str, Any] = {
        "schema": 1,
        "plant": simulation.reference,
        "forward": workspace.models.find(forward).reference,
        "full": full,
        "demand": course.demand if full else None,
        "controller": ("simple" if untuned else "tuned") if full else None,
        "path": {
            "name": course.path.name,
            "begin": course.path.points[0],
            "end": course.path.points[-1],
            "speed": course.path.speed,
        },
        "rows": [run.to_json() for run in runs],
        "files": files,
    }
    out.json(values)
    write_json(folder / "result.json", values)


def _on_machine(network: PolicyNetwork, course: TrackingTask) -> Policy:
    """The policy of a network on this machine."""
    from sysid_rl.train.residual_policy import ResidualPolicy
    from sysid_rl.train.tracking_task import TruncatedObservationPolicy

    if network.residual is not None:
        return ResidualPolicy(network, course.plant, course.inverse)
    return TruncatedObservationPolicy(network)


def _show(out: Printer, runs: list[TrackingResult]) -> None:
    from sysid_rl.train.tracking import SETTLED_S

    header = ("policy", "look-ahead", "RMSE x", "y", "z", "max x", "y", "z", "after 1 s: RMSE x", "y", "z", "max x", "y", "z")
    rows = []
    for run in runs:
        late = run.after(SETTLED_S)
        figures = [f"{1e3 * value:.2f}" for part in (run.rmse, run.worst, late.rmse, late.worst) for value in part]
        rows.append((run.policy, f"{1e3 * run.lookahead:.0f} ms", *figures))
    out.table(header, rows, right=range(1, len(header)))
    out.line("Errors in mm, end effector against target at the end of each step.")


def _only(workspace: Workspace, kind: str) -> str:
    """The only model of a kind; its promoted version, or its newest.

    Raises:
        StoreError: there is none, or several.
    """
    from sysid.errors import StoreError

    names = sorted({version.name for version in workspace.models.list(kind)})
    if len(names) != 1:
        listed = ", ".join(names) or "none"
        raise StoreError(f"workspace {workspace.location}", f"{len(names)} models of kind {kind} ({listed})", f"--{kind} NAME")
    return names[0]


def _forward_for(workspace: Workspace, plant: str) -> str:
    """The forward model of the dataset that a plant was made from; its promoted version, or its newest."""
    dataset = str(workspace.models.find(plant).lineage.get("dataset", "")).partition("@")[0]
    names = {version.name for version in workspace.models.list("forward")}
    return f"{dataset}-forward" if f"{dataset}-forward" in names else _only(workspace, "forward")
