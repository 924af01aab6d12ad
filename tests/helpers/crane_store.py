"""A registry with the crane's plant and forward models, for tests of what is loaded by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from crane_model import crane_plant

from sysid.networks import StructuredForward, to_files
from sysid.networks.chain import fit_chain
from sysid.plant import Plant, compile_plant
from sysid.registry import Registry
from sysid.signals import axis_signal
from sysid_rl.train.reach import joint_limits, tips


def learned(plant: Plant, axes: tuple[str, ...] | None = None) -> StructuredForward:
    """A forward model fitted on poses of a plant; ``axes`` gives its joints other names."""
    low, high = joint_limits(plant)
    joints = np.random.default_rng(0).uniform(low, high, (200, len(low)))
    revolute = (True, True, True, False)
    chain = fit_chain(joints, tips(compile_plant(plant), joints), revolute)
    names = tuple(axis_signal(axis, "joint") for axis in axes or plant.machine.axis_names)
    return StructuredForward(
        joints=names, revolute=revolute, structure=chain, urdf="", members=(), bound=0.0, low=low, high=high
    )


def crane_registry(folder: Path) -> Registry:
    """``crane`` (plant), ``crane-forward``, and ``other-forward`` of another machine's dataset."""
    registry, plant = Registry(folder), crane_plant()
    registry.register("crane", "plant", plant.to_files(), {"dataset": "crane@1", "machine": "crane"})
    kind, files = to_files(learned(plant))
    registry.register("crane-forward", kind, files, {"dataset": "crane@1"})
    registry.register("other-forward", kind, files, {"dataset": "digger@3"})
    kind, files = to_files(learned(plant, ("slew", "boom", "stick", "wrist")))
    registry.register("wrist-forward", kind, files, {"dataset": "crane@1"})
    return registry
