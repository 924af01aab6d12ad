"""What the registry does to a workspace, without the imports of other verbs."""

from __future__ import annotations

from pathlib import Path

from sysid.registry import Check, Registry, decide

FILES = {"plant.json": b"{}", "weights.json": b"[1]"}
PASSED = Check("rmse", "passed", "boom.joint: rmse 1 mrad")


def registered(workspace: Path) -> None:
    """``arm@1`` is the champion, ``arm@2`` the candidate."""
    registry = Registry(workspace)
    for number in (1, 2):
        registry.register("arm", "plant", FILES, {"n": number}, {"rmse": 0.5})
    decide(registry, "arm@1", None, [PASSED])


def broken(workspace: Path) -> None:
    registered(workspace)
    (workspace / "registry.db").write_bytes(b"not a database, but long enough to have a header" * 10)


def register(workspace: Path) -> None:
    Registry(workspace).register("arm", "plant", FILES, {"n": 3}, {"rmse": 0.4})


def promote(workspace: Path) -> None:
    registry = Registry(workspace)
    decide(registry, "arm@2", registry.promoted("arm"), [PASSED])


def repair(workspace: Path) -> None:
    Registry(workspace).repair()
