"""The machines of a fleet: one dataset each, all of one type."""

from __future__ import annotations

from collections.abc import Sequence

from sysid.errors import SettingsError
from sysid.machine import Machine, machine_from_files
from sysid.workspace import Workspace


def exact_references(place: Workspace, references: Sequence[str]) -> list[str]:
    """The exact dataset versions of machines of one type.

    Raises:
        SettingsError: no machine, one that is named twice, or machines of different types.
    """
    if not references:
        raise SettingsError("fleet", "no machine", "the dataset of at least one")
    exact: dict[str, Machine] = {}
    for reference in references:
        dataset, machine = described(place, reference)
        if dataset.partition("@")[0] in {other.partition("@")[0] for other in exact}:
            raise SettingsError("fleet", f"{dataset.partition('@')[0]} twice", "one dataset for each machine")
        exact[dataset] = machine
        first, kind = next(iter(exact.items()))
        if _type_of(machine) != _type_of(kind):
            raise SettingsError(
                f"fleet: {dataset}", f"axes {_words(machine)}", f"those of {first}: {_words(kind)}",
                "Compare machines of one type.",
            )  # fmt: skip
    return list(exact)


def described(place: Workspace, reference: str) -> tuple[str, Machine]:
    """The exact dataset version and its machine, from the manifest: no table is read."""
    manifest = place.datasets.manifest(reference)
    exact = f"{manifest['name']}@{manifest['version']}"
    return exact, machine_from_files(manifest["machine"], f"dataset {exact}")


def _type_of(machine: Machine) -> tuple[tuple[str, str, str], ...]:
    """What machines of one type share: axes with their actuation and what it drives."""
    return tuple((axis.name, axis.actuation, axis.drives) for axis in machine.axes)


def _words(machine: Machine) -> str:
    return ", ".join(f"{axis.name} ({axis.actuation}, {axis.drives})" for axis in machine.axes)
