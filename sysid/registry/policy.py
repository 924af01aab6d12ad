"""A trained policy of the registry: ``load_policy(registry.load("autolog-feedback")).act(observations)``."""

from __future__ import annotations

from sysid.errors import StoreError
from sysid.networks.policy import PolicyNetwork, policy_from_files
from sysid.registry.version import ModelVersion


def load_policy(version: ModelVersion) -> PolicyNetwork:
    """The policy in a version whose files are loaded (``Registry.load``).

    Raises:
        StoreError: it is a version of another kind, or its files are no policy.
    """
    if version.kind != "policy":
        raise StoreError(f"model {version.reference}", f"is of kind {version.kind!r}", "a policy")
    return policy_from_files(version.files, version.reference)
