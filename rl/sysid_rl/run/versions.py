"""The model versions of a run: loaded, promoted or accepted by name, and of this machine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sysid.errors import SettingsError
from sysid.machine import Machine
from sysid.networks import ActuatorNetwork, from_files, static_networks
from sysid.networks.forward import ForwardModel
from sysid.networks.policy import PolicyNetwork
from sysid.plant import Plant, plant_from_files
from sysid.registry import CHAMPION, ModelVersion, Registry, ancestors
from sysid.registry.policy import load_policy
from sysid_rl.run.recipe import KINEMATIC, RunnerRecipe
from sysid_rl.train.versions import load_versions


@dataclass(frozen=True)
class LoadedVersions:
    """The loaded versions.

    Args:
        policy: None: inverse kinematics; of one that offsets inverse kinematics, the network.
        actuators: axis → network, if the plant's linkages come from networks.
        versions: all of them, for the log.
        remarks: for the operator, one sentence each.
    """

    plant: Plant
    forward: ForwardModel
    policy: PolicyNetwork | None
    actuators: Mapping[str, ActuatorNetwork]
    versions: tuple[ModelVersion, ...]
    remarks: tuple[str, ...]


def load(registry: Registry, recipe: RunnerRecipe, machine: Machine, where: object) -> LoadedVersions:
    """The versions of a recipe.

    Raises:
        StoreError: no such version, or one of another kind.
        SettingsError: a version of another machine, or, for a machine, one that was never promoted and is not in
            ``versions.unpromoted``.
    """
    wanted = recipe.versions
    plant, forward = load_versions(registry, wanted.plant, wanted.forward)
    found = [registry.load(wanted.plant), registry.load(wanted.forward)]
    check_machine(plant.machine, machine, f"plant {found[0].reference}", where)
    remarks, policy = [], None
    if wanted.policy not in KINEMATIC:
        version = registry.load(wanted.policy)
        policy = load_policy(version)
        found.append(version)
        remarks += _policy_lineage(registry, version, found, machine, where)
    actuators: Mapping[str, ActuatorNetwork] = {}
    sources = [version for version in ancestors(registry.list(), found[0]) if version.kind in ("actuator", "history")]
    if sources:
        networks = registry.load(max(sources, key=lambda version: version.created_ms).reference)
        actuators = static_networks(from_files(networks.files, networks.reference))
        found.append(networks)
    _check_promoted(found, wanted.unpromoted, where, recipe.in_process)
    return LoadedVersions(plant, forward, policy, actuators, tuple(found), tuple(remarks))


def check_machine(own: Machine, machine: Machine, what: str, where: object) -> None:
    """Check that a version was made for this machine as it is.

    Raises:
        SettingsError: names what differs.
    """
    pairs = [
        ("its name", own.name, machine.name),
        ("its axes", own.axis_names, machine.axis_names),
        ("its rate", own.rate_hz, machine.rate_hz),
    ]
    if own.axis_names == machine.axis_names:
        for axis, twin in zip(own.axes, machine.axes, strict=True):
            for key in ("joint", "actuation", "drives", "gain", "stroke", "limits", "linkage"):
                pairs.append((f"{key} of {axis.name}", getattr(axis, key), getattr(twin, key)))
    pairs.append(("its URDF", _stripped(own.urdf_text), _stripped(machine.urdf_text)))
    for name, one, other in pairs:
        if one != other:
            found = f"was made for another machine: {name} is " + ("another" if name == "its URDF" else f"{one!r}")
            expected = f"that of {machine.name}" if name == "its URDF" else f"{other!r}"
            raise SettingsError(f"{where}: {what}", found, expected, "Run versions of this machine.")


def _policy_lineage(
    registry: Registry, policy: ModelVersion, others: list[ModelVersion], machine: Machine, where: object
) -> list[str]:
    """Remarks on the versions that a policy was trained on; those of another machine are refused."""
    remarks = []
    for kind, running in zip(("plant", "forward"), others, strict=False):
        trained = str(policy.lineage.get(kind, ""))
        if not trained:
            raise SettingsError(
                f"{where}: policy {policy.reference}", f"its lineage names no {kind}", "a policy of `sysid train`"
            )
        if trained == running.reference:
            continue
        remarks.append(f"policy {policy.reference} was trained on {trained}, {running.reference} runs")
        if kind == "plant":
            known = registry.load(trained)
            check_machine(plant_from_files(known.files, trained).machine, machine, f"policy {policy.reference}", where)
        elif trained.partition("@")[0] != running.name:
            found = f"was trained on the forward model {trained}"
            raise SettingsError(f"{where}: policy {policy.reference}", found, f"a version of {running.name}")
    return remarks


def _check_promoted(versions: list[ModelVersion], accepted: tuple[str, ...], where: object, in_process: bool) -> None:
    missing = [version for version in versions if CHAMPION not in version.aliases and version.reference not in accepted]
    if missing and not in_process:
        names = ", ".join(version.reference for version in missing)
        listed = ", ".join(f'"{version.reference}"' for version in missing)
        raise SettingsError(
            f"{where}: versions",
            f"never promoted: {names}",
            "promoted versions (`sysid models promote`)",
            f"To run them all the same: unpromoted = [{listed}].",
        )
    known = {version.reference for version in versions}
    for reference in accepted:
        if reference not in known:
            raise SettingsError(
                f"{where}: versions.unpromoted", f"{reference!r} does not run", f"of {', '.join(sorted(known))}"
            )


def _stripped(text: str | None) -> list[str]:
    return [line.rstrip() for line in (text or "").splitlines()]
