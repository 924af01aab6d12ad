"""A case of a row: a site with logs and description, which the workflow sees, and the truth, which only the scorer reads.

<folder>/site/…            machine.toml, a URDF where one is given, recipe.toml, logs/<recording>/log.csv
<folder>/truth.json        what is hidden, and the names that count as right
<folder>/clean/…           logs without sensor noise
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd


@dataclass(frozen=True)
class Hidden:
    """One hidden effect.

    Args:
        name: of the truth, a key of :data:`arms.names.ACCEPTED`.
        target: axis, signal or ``tool`` where it acts.
        parameters: true values in SI.
        due: whether a missing name counts; False where the log may not show it.
    """

    name: str
    target: str
    parameters: dict[str, Any] = field(default_factory=dict)
    due: bool = True


@dataclass(frozen=True)
class AxisText:
    """One ``[[axes]]`` entry of ``machine.toml``.

    Args:
        inertia: of a force axis [kg·m²]: its moving inertia; with a URDF that of the rotor behind its gear.
    """

    name: str
    actuation: str
    limits: tuple[float, float] | None = None
    joint: str | None = None
    inertia: float | None = None
    gain: float | None = None


@dataclass(frozen=True)
class Case:
    """What is written of one case.

    Args:
        name: unique in its row, ``<row>-<seed>`` and the variant.
        logs, clean: recording → table with canonical columns, with and without sensor noise.
        poses: whether the recordings are sets of static poses.
        known: effects that the owner's description states.
        files: the whole description, instead of one of ``axes``: file name → text.
        extra: further entries of the truth, for the scorer.
    """

    row: str
    name: str
    rate_hz: float
    axes: Sequence[AxisText]
    logs: Mapping[str, pd.DataFrame]
    clean: Mapping[str, pd.DataFrame]
    hidden: Sequence[Hidden]
    noise: Mapping[str, float] = field(default_factory=dict)
    urdf: str | None = None
    tip: str = "tip"
    poses: bool = False
    known: Sequence[Hidden] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)


def noisy(table: pd.DataFrame, noise: Mapping[str, float], draw: np.random.Generator) -> pd.DataFrame:
    """The log with white noise of these standard deviations, drawn signal by signal in this order."""
    return table.assign(**{name: table[name] + level * draw.standard_normal(len(table)) for name, level in noise.items()})


def write_case(case: Case, folder: Path) -> Path:
    """Write site, truth and clean logs of a case into ``folder``; returns the site."""
    site = folder / "site"
    site.mkdir(parents=True, exist_ok=True)
    files = case.files or {"machine.toml": machine_text(case)} | ({"arm.urdf": case.urdf} if case.urdf is not None else {})
    for name, text in files.items():
        (site / name).write_text(text, "utf-8")
    (site / "recipe.toml").write_text(recipe_text(case), "utf-8")
    for name in case.logs:
        _write_log(case.logs[name], site / "logs" / name)
        _write_log(case.clean[name], folder / "clean" / name)
    truth = {"row": case.row, "name": case.name, "hidden": [asdict(each) for each in case.hidden], **case.extra}
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", "utf-8")
    return site


def machine_text(case: Case) -> str:
    """``machine.toml`` of the owner."""
    lines = ["schema = 1", f'name = "{case.row}"', f"rate_hz = {case.rate_hz}"]
    if case.urdf is not None:
        lines += ['urdf = "arm.urdf"', f'tip = "{case.tip}"']
    for axis in case.axes:
        lines += ["", "[[axes]]", f'name = "{axis.name}"', f'actuation = "{axis.actuation}"', 'drives = "joint"']
        if case.urdf is not None:
            lines.append(f'joint = "{axis.joint}"')
        elif axis.limits is not None:
            lines.append(f"limits = [{axis.limits[0]:.9g}, {axis.limits[1]:.9g}]")
        if axis.inertia is not None:
            lines.append(f"inertia = {axis.inertia:.9g}")
        if axis.gain is not None:
            lines.append(f"gain = {axis.gain:.9g}")
    if case.noise:
        lines += ["", "[noise]", *(f'"{signal}" = {value:.6g}' for signal, value in case.noise.items())]
    for each in case.known:
        values = ", ".join(f"{key} = {value:.9g}" for key, value in each.parameters.items())
        lines += ["", "[[effects]]", f'name = "{each.name}"', f'target = "{each.target}"', f"parameters = {{ {values} }}"]
    return "\n".join(lines) + "\n"


def recipe_text(case: Case) -> str:
    """``recipe.toml``: recordings with canonical names; the roles are left to the dataset."""
    kind = "poses" if case.poses else "motion"
    listed = ", ".join(f'"{name}"' for name in case.logs)
    return f'schema = 1\nname = "{case.name}"\nmachine = "machine.toml"\nlogs = "logs"\n\n[recordings]\n{kind} = [{listed}]\n'


def _write_log(table: pd.DataFrame, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    table.to_csv(folder / "log.csv", index=False, float_format="%.9g")
