"""A policy as arrays: observations → joint setpoints, in NumPy without torch."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sysid.errors import StoreError
from sysid.networks.artifacts import STRUCTURE, WEIGHTS, Tensors, put_mlp, reading, take_mlp
from sysid.networks.mlp import Mlp

Array = npt.NDArray[np.float64]

#: Training curves, for reports only.
CURVES = "curves.json"
#: Settings of an offset.
RESIDUAL = ("share", "full_swing", "repeat")


@dataclass(frozen=True)
class PolicyNetwork:
    """``a = centre + half·tanh(perceptron(observation))``, centre and half of the limits of each setpoint.

    Args:
        inputs: names of the columns of an observation.
        outputs: joint signals of the setpoints.
        mlp: with the normalisation of observations.
        low, high: limits of each setpoint, (A,) [rad or m].
        full: whether it was trained on the full path (valves and plant); else joints follow at once.
        residual: where its outputs are shares of an offset of inverse kinematics: ``share``, ``full_swing`` and
            ``repeat``, the samples for which an offset is held; None: its outputs are setpoints.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    mlp: Mlp
    low: Array
    high: Array
    full: bool = False
    residual: Mapping[str, float] | None = None

    def act(self, observations: npt.ArrayLike) -> Array:
        """Setpoints (n, A) [rad or m], within their limits, for observations (n, O) [SI].

        Raises:
            InputError: observations of another width.
        """
        shares = self.mlp.predict(observations)
        np.tanh(shares, out=shares)
        shares *= self._half
        shares += self._centre
        return np.clip(shares, self.low, self.high, out=shares)  # rounding may exceed the limits

    @cached_property
    def _half(self) -> Array:
        return np.asarray(0.5 * (self.high - self.low))

    @cached_property
    def _centre(self) -> Array:
        return np.asarray(0.5 * (self.high + self.low))


def policy_to_files(policy: PolicyNetwork, curves: Mapping[str, object]) -> dict[str, bytes]:
    """Files of a policy for ``Registry.register``; equal policies and curves give equal bytes."""
    from safetensors.numpy import save

    tensors: Tensors = {"low": policy.low, "high": policy.high}
    put_mlp(tensors, "actor", policy.mlp)
    structure: dict[str, object] = {
        "schema": 1,
        "kind": "policy",
        "inputs": list(policy.inputs),
        "outputs": list(policy.outputs),
        "layers": len(policy.mlp.weights),
        "full": policy.full,
    }
    if policy.residual is not None:
        structure["residual"] = dict(policy.residual)
    texts = {STRUCTURE: structure, CURVES: {"schema": 1, **curves}}
    return {
        WEIGHTS: save(tensors),
        **{name: json.dumps(text, sort_keys=True, indent=1).encode() for name, text in texts.items()},
    }


def policy_from_files(files: Mapping[str, bytes], where: object) -> PolicyNetwork:
    """Inverse of :func:`policy_to_files`; ``where`` is the version, for messages.

    Raises:
        StoreError: a file is missing or invalid, or the layers do not fit together.
    """
    with reading(files, where, "a policy") as (structure, tensors):
        if structure["schema"] != 1 or structure["kind"] != "policy":
            found = f"{structure['kind']} of schema {structure['schema']!r}"
            raise StoreError(f"{where}: {STRUCTURE}", found, "a policy of schema 1", "Update the toolkit.")
        residual = structure.get("residual")
        policy = PolicyNetwork(
            inputs=tuple(structure["inputs"]),
            outputs=tuple(structure["outputs"]),
            mlp=take_mlp(tensors, "actor", structure["layers"], where),
            low=tensors["low"],
            high=tensors["high"],
            full=bool(structure["full"]),
            residual=None if residual is None else {key: float(residual[key]) for key in RESIDUAL},
        )
    widths = (len(policy.mlp.weights[0]), policy.mlp.weights[-1].shape[1])
    if widths != (len(policy.inputs), len(policy.outputs)) or not policy.low.shape == policy.high.shape == (widths[1],):
        found = f"{widths[0]} inputs and {widths[1]} outputs"
        raise StoreError(where, found, f"{len(policy.inputs)} and {len(policy.outputs)} as named, with their limits")
    return policy
