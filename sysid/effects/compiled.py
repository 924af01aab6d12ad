"""How an effect's functions are compiled (:mod:`sysid.compiled`), where effects of one's own look for it."""

from sysid.compiled import inlined, kernel, loop

__all__ = ["inlined", "kernel", "loop"]
