"""Packages that only part of the toolkit needs, and the extra of the distribution that installs each."""

from __future__ import annotations

import importlib.metadata
import importlib.util
from collections.abc import Iterable

DISTRIBUTION = "sysid-toolkit"
#: Imported module → extra. Everything else is a dependency of the core: ingest, quality, gap, report, ui.
EXTRAS: dict[str, str] = {
    "torch": "networks",
    "gymnasium": "train",
    "rerun": "view",
    "pybullet": "world",
    "pybullet_data": "world",
    "can": "runner",
    "cantools": "runner",
    "serial": "runner",
    "rosbags": "bags",
    "asammdf": "mf4",
    "pyulog": "flight",
    "pymavlink": "ardupilot",
    "pinocchio": "dynamics",
    "mujoco": "mujoco",
    "fmpy": "export",
    "pythonfmu": "export",
    "pxr": "usd",
    "newton_usd_schemas": "usd",
    "onnx": "onnx",
    "onnxruntime": "onnx",
    "distributed": "cluster",
    "tensorboard": "tensorboard",
}


def installed(module: str) -> bool:
    """Whether a package of an extra can be imported."""
    return importlib.util.find_spec(module) is not None


def extra_of(error: ModuleNotFoundError) -> str:
    """The extra that installs a missing module; empty if none does."""
    return EXTRAS.get((error.name or "").partition(".")[0], "")


def install_command(module: str) -> str:
    """The command that installs the extra of an imported module.

    Raises:
        KeyError: no extra installs it.
    """
    return f"pip install '{DISTRIBUTION}[{EXTRAS[module.partition('.')[0]]}]'"


def install_remedy(module: str) -> str:
    """The remedy in every message about a module that is not installed: the command of its extra.

    Raises:
        KeyError: no extra installs it.
    """
    return f"{install_command(module)} installs it."


def versions_of(names: Iterable[str]) -> dict[str, str]:
    """Name of a distribution → its version, or ``not installed``."""
    found = {}
    for name in names:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found
