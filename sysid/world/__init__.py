"""PyBullet simulation of a plant version: rigid bodies with a hanging tool, contact with ground and logs, and a camera."""

from sysid.world.world import Log, World, WorldState

__all__ = ["Log", "World", "WorldState"]
