"""A palletiser: a passive joint (mimic), its parallel linkage, keeps the wrist level."""

from __future__ import annotations

JOINTS = ("slew", "shoulder", "elbow", "wrist")
ORIGINS = {"slew": "0 0 0.3", "shoulder": "0.1 0 0.4", "elbow": "0 0 0.8", "leveller": "0.7 0 0", "wrist": "0.1 0 -0.1"}
SHOULDER = '<mimic joint="shoulder" multiplier="-1" offset="0.2"/>'


def urdf(leveller: str = SHOULDER, elbow: str = "") -> str:
    """Slew, shoulder and elbow; the leveller follows; the wrist turns about the vertical."""
    parts = ['<robot name="palletiser"><link name="base"/>']
    parent, axes = "base", {"slew": "0 0 1", "wrist": "0 0 1"}
    for number, (name, origin) in enumerate(ORIGINS.items()):
        mimic = {"leveller": leveller, "elbow": elbow}.get(name, "")
        parts.append(
            f'<link name="{name}_link"><inertial><origin xyz="0.1 0 0.1"/><mass value="{10.0 - number}"/></inertial></link>'
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<origin xyz="{origin}"/><axis xyz="{axes.get(name, "0 1 0")}"/><limit lower="-1.5" upper="1.5"/>{mimic}</joint>'
        )
        parent = f"{name}_link"
    return "".join(parts) + "</robot>"
