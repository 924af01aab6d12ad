"""Suggested roles of recordings on the console."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sysid.cli.output import Printer, write_json

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sysid.datasets.checks.roles import Lack
    from sysid.datasets.split_suggestion import SplitSuggestion


def show_suggestion(location: str, reference: str, json_file: str | None) -> None:
    """Present and suggested roles side by side, and the command or the lines of the recipe that apply the suggestion."""
    from sysid.datasets import Store
    from sysid.datasets.checks.roles import unmet_need
    from sysid.datasets.split_suggestion import recipe_splits, suggest_split

    out = Printer(json_file)
    store = Store(location)
    manifest = store.manifest(reference)
    dataset = store.load(f"{manifest['name']}@{manifest['version']}")
    texts = dict.fromkeys(part["made"]["recipe"] for part in manifest["parts"])
    found = suggest_split(dataset, [recipe_splits(text, f"{dataset.reference}: recipe") for text in texts if text])
    _show_motion(out, found)
    _show_recordings(out, found)
    if found.named:
        out.line(f"named in the recipe, unchanged: {_some(found.named)}")
    need = unmet_need(dataset)
    if need is not None and not found.better:
        out.line(f"note: {need.text}")
    elif not found.better:
        lacking = "No other roles give the axes more motion where it is missing."
        out.line(lacking if found.suggested.lacks else "No role lacks motion.")
    elif found.cut:
        out.line(f"{_some(found.cut)}: cut into a block for each role, so that each contains its motion.")
    _show_lacks(out, "with the present roles", found.present.lacks if found.better else ())
    if need is None or found.better:
        _show_lacks(out, "with the suggestion" if found.better else "lacking", found.suggested.lacks, record=True)
    for test, other in found.repeats:
        out.line(
            f"{test} (test) has the same commands as {other}: its error shows repeatability, not accuracy on other motion."
        )
    applied = found.command(location)
    if applied:
        out.line("Apply it to this version:")
        out.line(f"  {applied}")
    if found.recipe:
        out.line(
            "Or write it in the recipe, and ingest the logs again:" if applied else "Write in the recipe, and ingest again:"
        )
        out.block("\n".join(f"  {line}" for line in found.recipe.splitlines()))
    write_json(json_file, found.to_json(location))


def _show_motion(out: Printer, found: SplitSuggestion) -> None:
    """Seconds of motion per direction, and reversals, of every axis in each role."""
    from sysid.datasets.checks.roles import ROLE_NAMES, ROLES

    shown = {"now": found.present, **({"suggested": found.suggested} if found.better else {})}
    rows: list[tuple[str, ...]] = []
    for axis in found.present.motion["fit"]:
        for number, role in enumerate(ROLES):
            cells = [axis if number == 0 else "", ROLE_NAMES[role]]
            for one in shown.values():
                motion = one.motion[role][axis]
                cells += [f"{motion.backward_s:.1f} / {motion.forward_s:.1f}", f"{motion.reversals:.0f}"]
            rows.append(tuple(cells))
    columns = [column for title in shown for column in (f"{title} s − / +", "reversals")]
    out.table(("axis", "role", *columns), rows, right=range(2, 6))
    for title, one in shown.items():
        out.line(f"{title}: {', '.join(f'{ROLE_NAMES[role]} {one.seconds[role]:.0f} s' for role in ROLES)}")


def _show_recordings(out: Printer, found: SplitSuggestion) -> None:
    from sysid.datasets.checks.roles import ROLE_NAMES

    changed = {**dict.fromkeys(found.cut, "cut"), **{name: ROLE_NAMES[role] for name, role in found.changed.items()}}
    if changed:
        rows = [
            (name, f"{found.seconds[name]:.1f} s", ROLE_NAMES[found.present.roles[name]], changed[name])
            for name in found.present.roles
            if name in changed
        ]
        out.table(("recording", "length", "now", "suggested"), rows, right=(1,))


def _show_lacks(out: Printer, title: str, lacks: Sequence[Lack], *, record: bool = False) -> None:
    for lack in lacks:
        out.line(f"{title}: {lack.text}")
        if record:
            out.line(f"  → {lack.record}")


def _some(names: Sequence[str], most: int = 8) -> str:
    """Names, the first ones where there are many."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
