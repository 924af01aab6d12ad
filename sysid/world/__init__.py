"""The PyBullet world: a plant version as rigid bodies that hang, touch the ground and can be photographed."""

from sysid.world.scene import Log
from sysid.world.world import World, WorldState

__all__ = ["Log", "World", "WorldState"]
