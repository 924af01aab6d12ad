"""The command line: one verb a file, each loaded when it is called."""

from sysid.cli.app import main

__all__ = ["main"]
