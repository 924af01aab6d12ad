"""The repaired MJCF of ``sysid gap --simulator mujoco:FILE.xml``: what is written, and what the console says about it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.cli.output import Printer

if TYPE_CHECKING:
    from sysid.datasets.recording import Dataset
    from sysid.gap.adapters.adapter import SimulatorAdapter
    from sysid.gap.result import GapResult
    from sysid.plant import Plant


def repaired_path(model: Path) -> Path:
    """Where ``--add`` writes the repaired model of an MJCF."""
    return model.with_suffix(f".repaired{model.suffix}")


def write_model(
    out: Printer,
    tested: SimulatorAdapter | Plant,
    result: GapResult,
    dataset: Dataset,
    model: Path,
    path: Path,
    assets: tuple[Path, ...] = (),
) -> dict[str, Any]:
    """Write the repaired model, and return what the JSON says about it.

    Raises:
        InputError: the written model does not do what the repaired simulation does.
    """
    from sysid.gap.adapters.mujoco import model as mujoco_model
    from sysid.plant.plant import effect_key

    repaired = mujoco_model.write_model(model, tested, result, path, dataset, assets)
    out.line(f"Repaired model: {repaired.path}")
    for change in repaired.native:
        out.line(f"    {change.effect.name} of {change.effect.target}: {change.where}")
    for item in repaired.beside:
        why = repaired.reasons.get(effect_key(item), "")
        kept = repaired.side_path is not None and not why
        where = f"{repaired.side_path}, which MJCF cannot express" if kept else "not written"
        out.line(f"    {item.name} of {item.target}: {where}{f' ({why})' if why else ''}")
    if repaired.fitted:
        out.line(f"    fitted once more in MuJoCo, within their intervals: {repaired.fitted}")
    for signal, value in repaired.gap.after.items():
        before, floor = repaired.gap.before[signal], repaired.gap.noise_floor[signal]
        out.line(
            f"    {signal}: error {value:.3g}, loaded again, on held-out recordings (before {before:.3g}, floor {floor:.3g})"
        )
    return {
        "path": str(repaired.path),
        "side_file": str(repaired.side_path) if repaired.side_path is not None else None,
        "native": [{"name": c.effect.name, "target": c.effect.target, "where": c.where} for c in repaired.native],
        "beside": [
            {"name": item.name, "target": item.target, "why": repaired.reasons.get(effect_key(item), "")}
            for item in repaired.beside
        ],
        "fitted": repaired.fitted,
        "gap": {"before": dict(repaired.gap.before), "after": dict(repaired.gap.after)},
    }
