"""The flight logs as a dataset: every run is a recording with two streams, the runner's log and the motion capture."""

from __future__ import annotations

from pathlib import Path

from simulated_bench.recipe import AXES, BenchRecipe
from sysid.datasets import Dataset, ingest
from sysid_rl.run.flight_log import recipe_text

#: Rest at the beginning of every run by which the joints of the rigid bodies are zeroed [s].
REFERENCE_S = (0.2, 1.2)


def ingest_flights(logs: Path, machine: BenchRecipe, signals: tuple[str, ...], workspace: Path) -> Dataset:
    """A version of the dataset of this machine with all runs in ``logs``.

    Args:
        machine: as its owner describes it: where it is parked and where its cameras stand.
    """
    recipe = logs.parent / "recipe.toml"
    recipe.write_text(recipe_text(logs, AXES, signals) + _capture_lines(machine), "utf-8")
    return ingest(logs, workspace, logs / "machine.toml", recipe)


def _capture_lines(machine: BenchRecipe) -> str:
    capture = machine.capture
    bodies = [f'{body.name} = "{body.link}"' for body in capture.bodies if body.link != "gripper"]
    points = [
        f'{point} = {{ body = "{body.name}" }}'
        for point, link in (("ee", "tip"), ("tool", "gripper"))
        for body in capture.bodies
        if body.link == link
    ]
    joints = ", ".join(f"{name} = {machine.axis(name).park}" for name in AXES)
    lines = [
        "",
        "[[streams]]",
        'files = "mocap.csv"',
        'reader = "motive"',
        'domain = "mocap"',
        'interpolation = "cubic"',
        'secondary = ["slew.joint", "telescope.joint"]',
        "[streams.frame]",
        f"translation = {list(capture.translation)}",
        f"rpy = {list(capture.rpy)}",
        "[streams.bodies]",
        *bodies,
        "[streams.points]",
        *points,
        "[streams.reference]",
        'recording = "motion-*"',
        f"seconds = {list(REFERENCE_S)}",
        f"joints = {{ {joints} }}",
    ]
    return "\n".join(lines) + "\n"
