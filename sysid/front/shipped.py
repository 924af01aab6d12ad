"""Pipelines and logs of demos: those of the checkout that this package is installed from, else those of its wheel."""

from __future__ import annotations

from pathlib import Path

from sysid.errors import SettingsError

#: The root of a checkout, and the part of a wheel that holds the same files.
CHECKOUT = Path(__file__).resolve().parents[2]
SHIPPED = Path(__file__).resolve().parents[1] / "shipped"


def demo_logs() -> Path:
    """The logs of ``sysid demo``: a hydraulic crane of four axes, with its ``machine.toml`` and ``recipe.toml``.

    Raises:
        SettingsError: they are neither in a checkout nor in the wheel.
    """
    return shipped_file("datasets/autolog/machine.toml", CHECKOUT, SHIPPED).parent


def shipped_file(name: str, checkout: Path, shipped: Path) -> Path:
    """A file of a checkout, else of the wheel.

    Raises:
        SettingsError: neither is there.
    """
    # The folder of installed packages may contain another package named `pipelines`.
    if (checkout / "pyproject.toml").is_file() and (checkout / name).is_file():
        return checkout / name
    if (shipped / name).is_file():
        return shipped / name
    remedy = "Install the wheel again, or clone the repository and type `make demo`."
    raise SettingsError("sysid demo", f"no {name} in {checkout} or {shipped}", "the files of the wheel", remedy)
