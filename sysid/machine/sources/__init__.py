"""Drafts of ``machine.toml`` from descriptions of other tools: URDF and MJCF."""
