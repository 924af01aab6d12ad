"""``sysid models [MODEL]``: networks and plants in the registry, or where one of them came from."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

from sysid.cli.output import Printer, json_option, write_json

if TYPE_CHECKING:
    from sysid.registry import ModelVersion

CARRIES = "carries unnamed_residual: a bounded network learned from the recordings. It is no physics and names no cause."


@click.command()
@click.argument("reference", metavar="[NAME[@VERSION]]", required=False)
@click.option("--kind", default=None, help="actuator, forward, plant or policy only.")
@click.option("--promote", is_flag=True, help="Let the name alone mean this version from now on.")
@json_option
@click.pass_obj
def models(workspace: str, reference: str | None, kind: str | None, promote: bool, json_file: str | None) -> None:
    """List model and plant versions, show the lineage of one, or promote one."""
    from sysid.errors import SettingsError
    from sysid.workspace import open_workspace

    registry = open_workspace(workspace).models
    out = Printer(json_file)
    if promote and (reference is None or "@" not in reference):
        raise SettingsError("sysid models --promote", reference or "no model", "one version, as in autolog@1")
    if reference is not None:
        version = registry.find(reference)
        if promote:
            until_now = registry.promoted(version.name)
            version = registry.promote(version.reference, instead_of=until_now)
            instead = f" instead of {until_now.reference}" if until_now not in (None, version) and until_now else ""
            out.line(f"`{version.name}` alone means {version.reference} from now on{instead}.")
            write_json(json_file, {"schema": 1, **version.to_json(), "instead_of": until_now and until_now.reference})
            return
        known = f"  ({', '.join(version.aliases)})" if version.aliases else ""
        out.line(f"{version.reference}{known}  {version.kind}  {version.digest}")
        out.line(json.dumps(dict(version.lineage), indent=2, ensure_ascii=False))
        if "machine.diff" in version.sha256:
            out.line(registry.load(version.reference).files["machine.diff"].decode("utf-8"))
        if _carries(version):
            out.line(CARRIES)
        for name, value in version.metrics.items():
            out.line(f"{name} = {value:.6g}")
        write_json(json_file, {"schema": 1, **version.to_json()})
        return
    versions = registry.list(kind)
    write_json(json_file, {"schema": 1, "models": [version.to_json() for version in versions]})
    if not versions:
        out.line(f"No models in {workspace} yet: sysid fit makes networks, sysid gap makes plants.")
        return
    rows = [
        (
            version.reference,
            f"{version.kind}{' *' if _carries(version) else ''}",
            version.lineage.get("dataset", "–"),
            ", ".join(version.aliases),
            version.digest[:12],
        )
        for version in versions
    ]
    out.table(("model", "kind", "made from", "aliases", "content"), rows)
    if any(map(_carries, versions)):
        out.line(f"* {CARRIES}")


def _carries(version: ModelVersion) -> bool:
    """Whether a plant holds a residual network beside its effects."""
    return version.kind == "plant" and "residuals.safetensors" in version.sha256
