"""Effects beside an MJCF: what a repair cannot write into the model, in ``<model>.effects.toml`` in its folder.

The adapter loads it with the model: its input effects act on the commands, its output effects on the signals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sysid.config import Strict, load_settings
from sysid.files import written_whole
from sysid.machine import KnownEffect
from sysid.plant import effects_toml
from sysid.quoting import comment, toml_value


@dataclass(frozen=True)
class SideFile(Strict):
    """Content of the file."""

    schema: Literal[1]
    model: str
    effects: tuple[KnownEffect, ...] = ()


def side_file(model: Path) -> Path:
    """Path of the file that belongs to an MJCF."""
    return model.with_suffix(".effects.toml")


def read_side_file(model: Path) -> tuple[KnownEffect, ...]:
    """The effects beside an MJCF; none without the file.

    Raises:
        SettingsError: an unknown key or a wrong value.
    """
    path = side_file(model)
    return load_settings(path, SideFile).effects if path.is_file() else ()


def write_side_file(model: Path, effects: Sequence[KnownEffect]) -> Path | None:
    """Write the effects beside an MJCF; without any, remove an earlier file. The path, or None."""
    path = side_file(model)
    if not effects:
        path.unlink(missing_ok=True)
        return None
    name = comment(model.name)
    head = f"# Effects beside {name}, which MJCF cannot express. sysid gap --simulator mujoco:{name} loads them.\n"
    text = f"{head}schema = 1\nmodel = {toml_value(model.name)}\n\n{effects_toml(effects)}"
    with written_whole(path) as half:
        half.write_text(text, "utf-8")
    return path
