"""``sysid ingest --propose-frame PATH…``: the capture frame from a survey. Nothing is stored."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.cli.output import Printer, write_json
from sysid.display import quantity
from sysid.errors import SettingsError

if TYPE_CHECKING:
    from sysid.datasets.frames.survey import SurveyResult


def propose(paths: Sequence[Path], machine: Path | None, recipe: Path | None, json_file: str | None) -> None:
    """Print a ``[streams.frame]`` for every survey in the recipe.

    Raises:
        SettingsError: no recipe, no survey in it, or no machine.
        InputError: a survey that does not determine the frame.
    """
    from sysid.datasets.draft import default_machine
    from sysid.datasets.frames.survey import propose_frames
    from sysid.datasets.recipe import check_against_machine, load_recipe
    from sysid.machine import load_machine

    recipe = recipe if recipe is not None else next((p / "recipe.toml" for p in paths if (p / "recipe.toml").is_file()), None)
    if recipe is None:
        raise SettingsError("--propose-frame", "no recipe", "a recipe with [streams.survey]", "Name it with --recipe.")
    rules = load_recipe(recipe)
    named = recipe.parent / rules.machine if rules.machine is not None else None
    machine = machine if machine is not None else named if named is not None else default_machine([*paths, recipe])
    if machine is None:
        raise SettingsError(
            recipe, "no machine description", "machine.toml", "Give one with --machine, or name it in the recipe."
        )
    description = load_machine(machine)
    check_against_machine(rules, description, recipe)
    found = propose_frames(paths, rules, description, recipe)
    out = Printer(json_file)
    for item in found:
        _show(out, item)
    write_json(json_file, {"schema": 1, "frames": [_plain(item) for item in found]})


def _show(out: Printer, item: SurveyResult) -> None:
    proposal = item.proposal
    what = "static markers" if proposal.method == "markers" else "rotating points"
    left = f"residual {quantity(proposal.rms_m, 'm')} RMS, {quantity(proposal.max_m, 'm')} maximum"
    out.line(f"{item.source}: from {len(proposal.names)} {what} ({', '.join(proposal.names)}): {left}")
    rows = [
        (axis, quantity(place, "m", 4), _half(place95, "m"), quantity(turn, "rad", 4), _half(turn95, "rad"))
        for axis, place, place95, turn, turn95 in zip(
            "xyz", proposal.frame.translation, proposal.translation95, proposal.frame.rpy, proposal.rotation95, strict=True
        )
    ]
    out.table(("base axis", "place", "± 95 %", "rpy", "± 95 % about the axis"), rows, right=(1, 2, 3, 4))
    for text in proposal.open:
        out.line(f"open: {text}")
    for text in proposal.notes:
        out.line(f"note: {text}")
    of = "frame" if proposal.method == "markers" else "axis"
    out.line(f"The recipe's own {of} differs by {quantity(item.moved_m, 'm')} and {quantity(item.turned_rad, 'rad')}.")
    out.line("To use it, copy these lines to the recipe:")
    out.line()
    out.block(proposal.lines)
    out.line()


def _half(value: float, unit: str) -> str:
    return quantity(value, unit, 2) if math.isfinite(value) else "open"


def _plain(item: SurveyResult) -> dict[str, Any]:
    values = asdict(item.proposal)
    for key in ("translation95", "rotation95"):
        values[key] = [value if math.isfinite(value) else None for value in values[key]]
    differs = {"moved_m": item.moved_m, "turned_rad": item.turned_rad}
    return {"source": str(item.source), **values, "lines": item.proposal.lines, **differs}
