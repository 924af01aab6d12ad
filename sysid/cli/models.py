"""``sysid models [MODEL]``: networks and plants in the registry, or where one of them came from."""

from __future__ import annotations

import json

import click

from sysid.cli.output import Printer, json_option, write_json


@click.command()
@click.argument("reference", metavar="[NAME[@VERSION]]", required=False)
@click.option("--kind", default=None, help="actuator, forward, plant or policy only.")
@json_option
@click.pass_obj
def models(workspace: str, reference: str | None, kind: str | None, json_file: str | None) -> None:
    """List model and plant versions, or show the lineage of one."""
    from sysid.workspace import open_workspace

    registry = open_workspace(workspace).models
    out = Printer(json_file)
    if reference is not None:
        version = registry.find(reference)
        out.line(f"{version.reference}  {version.kind}  {version.digest}")
        out.line(json.dumps(dict(version.lineage), indent=2, ensure_ascii=False))
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
        (version.reference, version.kind, version.lineage.get("dataset", "–"), ", ".join(version.aliases), version.digest[:12])
        for version in versions
    ]
    out.table(("model", "kind", "made from", "aliases", "content"), rows)
