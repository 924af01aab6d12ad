"""The record of a commissioning, beside the recipe; invalid after a change of recipe, database, machine or plant."""

from __future__ import annotations

import hashlib
import json
import shlex
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sysid.errors import SettingsError
from sysid.files import write_durably
from sysid_rl.run.assemble import Assembly
from sysid_rl.run.checks.settings import SHORTEST_REASON
from sysid_rl.run.modes.commission import Commission

#: Sections of a recipe that concern wiring and limits, in contrast to task, log and loop.
RECIPE_SECTIONS = ("machine", "transport", "limits", "checks", "commission")


def record_path(recipe: Path) -> Path:
    """The file of the record of ``recipe``."""
    return recipe.with_name(f"{recipe.stem}.commissioned.json")


def digests(assembly: Assembly) -> dict[str, str]:
    """SHA-256 of everything for which a commissioning is valid."""
    recipe = asdict(assembly.recipe)
    chosen = {name: recipe[name] for name in RECIPE_SECTIONS}
    chosen["plant"] = recipe["versions"]["plant"]
    machine = assembly.machine_file.read_bytes() + (assembly.machine.urdf_text or "").encode()
    found = {
        "recipe": _digest(json.dumps(chosen, sort_keys=True, default=str).encode()),
        "machine": _digest(machine),
        "plant": assembly.loaded.versions[0].digest,
    }
    database = assembly.recipe.transport.get("database")
    if isinstance(database, str):
        found["database"] = _digest((assembly.folder / database).read_bytes())
    return found


def keep_record(assembly: Assembly, mode: Commission, recipe: Path, log: str) -> Path:
    """Write the results of a commissioning, whether or not it passed, as a whole or not at all.

    Returns:
        The file.

    Raises:
        StorageError: the disk is full or fails.
    """
    path = record_path(recipe)
    record = {
        "schema": 1, "recipe": recipe.name, "machine": assembly.machine.name, "passed": mode.passed,
        "date": datetime.now(UTC).isoformat(timespec="seconds"), "log": log, "digests": digests(assembly), **mode.figures(),
    }  # fmt: skip
    text = json.dumps(record, indent=1, ensure_ascii=False) + "\n"
    write_durably(path, text.encode(), "record of the commissioning", "Make room on the disk, and commission again.")
    return path


def require_commissioned(assembly: Assembly, recipe: Path) -> str:
    """The state of the commissioning in words, before a machine is moved.

    Raises:
        SettingsError: there is no record, it did not pass, or something has changed since, and the recipe does not waive it.
    """
    waived = assembly.recipe.commission.waived.strip()
    missing = _invalid_reason(assembly, record_path(recipe))
    if not missing:
        return "commissioned as it is"
    if waived and len(waived) < SHORTEST_REASON:
        raise SettingsError(f"{recipe}: commission.waived", f"the reason {waived!r}", "one sentence with the reason")
    if waived:
        return f"NOT commissioned ({missing}): {waived}"
    raise SettingsError(
        f"{recipe}: commissioning",
        missing,
        "a machine whose wiring, signs, scales and zeros were checked one axis at a time",
        f'First: sysid run {shlex.quote(str(recipe))} --commission. To run without it: [commission] waived = "why".',
    )


def _invalid_reason(assembly: Assembly, path: Path) -> str:
    """Why the record is not valid; "" if it is."""
    try:
        record: Any = json.loads(path.read_text("utf-8"))
        known, passed = dict(record["digests"]), record["passed"] is True and record["schema"] == 1
    except FileNotFoundError:
        return "it was never commissioned"
    except (OSError, ValueError, KeyError, TypeError):
        return f"{path} is no record of a commissioning"
    if not passed:
        return f"its commissioning did not pass: {record.get('wrong') or 'it was not finished'}"
    now = digests(assembly)
    changed = [name for name in sorted({*now, *known}) if now.get(name) != known.get(name)]
    return f"changed since it was commissioned: {', '.join(changed)}" if changed else ""


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
