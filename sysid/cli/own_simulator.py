"""``--simulator FILE.py:NAME`` or ``mujoco:FILE.xml``: loads a user's simulator; and writes a repaired MuJoCo model."""

from __future__ import annotations

import importlib.util
import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.cli.output import Printer
from sysid.errors import InputError, SettingsError, nearest

if TYPE_CHECKING:
    from sysid.datasets.recording import Dataset
    from sysid.gap import Simulator
    from sysid.gap.adapters.adapter import SimulatorAdapter
    from sysid.gap.result import GapResult
    from sysid.plant import Plant


#: Prefix of an MJCF.
MUJOCO = "mujoco:"


def open_simulator(
    place: str, dataset: Dataset, assets: tuple[Path, ...] = (), tell: Callable[[str], object] = print
) -> Simulator | Plant:
    """The simulator of a Python file or of an MJCF, for a dataset.

    Of an MJCF, that of :func:`sysid.gap.adapters.mujoco.model.open_model`.

    Args:
        assets: further folders below which an MJCF may open files.
        tell: takes the reason for which a model of servos is run itself.

    Raises:
        SettingsError: neither ``FILE.py:NAME`` nor ``mujoco:FILE.xml``, or a model that does not fit the machine.
        InputError: no such file, an error in it, or no simulator.
    """
    if not place.startswith(MUJOCO):
        return load_simulator(place)
    from sysid.gap.adapters.mujoco.model import open_model

    return open_model(Path(place.removeprefix(MUJOCO)), dataset, assets, tell)


def load_simulator(place: str) -> Simulator:
    """The object ``NAME`` of a Python file; a class is instantiated without arguments.

    The file's folder is searched for the modules that it imports.

    Raises:
        SettingsError: not ``FILE.py:NAME``.
        InputError: no such file, an error in it, or NAME is no simulator.
    """
    from sysid.gap import Simulator

    file, _, name = place.rpartition(":")
    path = Path(file)
    if path.suffix != ".py" or not name.isidentifier():
        raise SettingsError(
            f"--simulator {place}", "not a file and a name in it", "FILE.py:NAME, as in crane.py:Crane, or mujoco:FILE.xml"
        )
    if not path.is_file():
        raise InputError(f"--simulator {path}", "no such file", "a Python file")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise InputError(f"--simulator {path}", "cannot be imported", "a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(path.resolve().parent))
    try:
        spec.loader.exec_module(module)
        if not hasattr(module, name):
            names = [n for n, value in vars(module).items() if hasattr(value, "simulate")]
            raise InputError(f"--simulator {path}", f"no {name!r} in it", nearest(name, names))
        found = getattr(module, name)
        simulator = found() if inspect.isclass(found) else found
    except InputError:
        raise
    except Exception as error:  # whatever a user's file may raise
        raise InputError(f"--simulator {path}", f"{type(error).__name__}: {error}", "a file that runs") from error
    finally:
        sys.path.remove(str(path.resolve().parent))
    if not isinstance(simulator, Simulator):
        raise InputError(
            f"--simulator {place}",
            f"{name} has no method simulate",
            "simulate(recording) → DataFrame",
            "See sysid.gap.Simulator.",
        )
    return simulator


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
