"""Versions and their sources, settings and software of the figures."""

from __future__ import annotations

from typing import Any

from sysid.reports.inputs import ReportInputs


def context(inputs: ReportInputs) -> dict[str, Any]:
    gap = inputs.gap
    return {
        "rows": [
            {
                "reference": note.reference,
                "kind": note.kind,
                "digest": note.digest[:12],
                "parents": ", ".join(note.parents),
                "note": note.note,
            }
            for note in inputs.versions
        ],
        "software": dict(inputs.software),
        "settings": {key: str(value) for key, value in (gap.settings if gap is not None else {}).items()},
        "notes": gap.notes if gap is not None else (),
        "digest": inputs.dataset.digest,
        "reference": inputs.dataset.reference,
    }
