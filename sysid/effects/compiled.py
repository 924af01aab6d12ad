"""Decorators that compile the functions of an effect (:mod:`sysid.compiled`)."""

from sysid.compiled import inlined, kernel, loop

__all__ = ["inlined", "kernel", "loop"]
