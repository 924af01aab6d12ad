"""Rerun recordings: the moving machine, measured and simulated, with its signals."""

from sysid.view.recording import write_rerun

__all__ = ["write_rerun"]
