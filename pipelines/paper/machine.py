"""Policy 1 on the machine: the runner over the CAN bus of the simulated test bench, measured at the gripper."""

from __future__ import annotations

from pathlib import Path

from loop.deployment import WIDE, Deployment
from loop.flight import Flight, fly
from loop.rounds import path_task
from paper.rows import MACHINE_MAX, PaperRow
from simulated_bench.recipe_file import load_recipe
from sysid.pictures import PictureCurve, svg
from sysid.workspace import Workspace

#: The disabled check of the supervisor, with its reason.
WITHOUT = {"domain": "the paper's network is used as it is, also between its poses"}


def deploy(place: Workspace, site: Path, logs: Path, plant: str, forward: str, policy: str, seed: int) -> dict[str, Flight]:
    """Helix and circle under a policy and the controller of a plant.

    Args:
        site: folder of the machine's description and of its bench recipe.
        policy: a version, or ``ik``.
    """
    machine = load_recipe(site / "bench.toml")
    deployment = Deployment(plant, forward, policy, {**WIDE, "policy": {"share": 1.0}, "without": WITHOUT})
    flights = {}
    for number, path in enumerate(("helix", "circle")):
        task = path_task(path)
        flights[path] = fly(machine, site, logs, place.models, deployment, task, 100 * seed + number)
    return flights


def rows(flights: dict[str, Flight], name: str, seed: int) -> list[PaperRow]:
    """Largest errors of the tool; the paper has those of policy 1 on the helix."""
    found = []
    for path, flight in flights.items():
        paper = MACHINE_MAX if (path, name) == ("helix", "policy 1") else None
        values = tuple(float(value) for value in flight.figures()["max_mm"])
        share = 100.0 * flight.sources.get("track", 0.0)  # the rest is held, or by the fallback
        condition = f"simulated test bench, nominal plant; {share:.0f} % of the cycles by {name}"
        what = f"{name} on the {path}, max x / y / z at the tool"
        found.append(PaperRow("table of tracking errors, machine", what, condition, paper, values, "mm", seed))
    return found


def error_picture(flight: Flight) -> str:
    """Error of the tool over time, SVG."""
    colours = zip("xyz", ("#0f766e", "#c2410c", "#4338ca"), strict=True)
    time, error = flight.time - flight.time[0], 1e3 * flight.error
    curves = [PictureCurve(letter, time, error[:, k], colour) for k, (letter, colour) in enumerate(colours)]
    return svg(f"error of the tool on the {flight.path}", "time [s]", "error [mm]", curves)
