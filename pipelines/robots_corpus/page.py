"""Rows of the result file, counts over them, and the page of reports/robots/."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from committed import markdown
from robots_corpus.reading import LIMITS
from robots_corpus.steps import SAME

Row = Mapping[str, Any]
#: Steps after the first one, with what they report on failure.
_AFTER = ("check", "log", "export")


def published(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """Rows in the shape of the contract, with what led to them."""
    return [_published(row) for row in rows if row]


def _published(row: Row) -> dict[str, Any]:
    check, log, export = (row.get(step, {}) for step in _AFTER)
    steps = row["steps"]
    reason = row["reason"] or (steps[0]["message"] if steps else "")
    broke = {step: text for step, text in [("init", row["broke"]), *((s, row.get(s, {}).get("broke")) for s in _AFTER)] if text}
    return {
        "package": row["package"],
        "file": row["file"],
        "status": row["status"],
        "reason": f"{row['outside']}: {reason}" if "outside" in row else reason,
        "read": row["read"],
        "remedies": steps,
        "axes": check.get("axes"),
        "checked": {key: check[key] for key in SAME if key in check},
        "peer": check.get("peer") or check.get("peer_failed", ""),
        "noted": check.get("differs", []),
        "wrong": check.get("wrong", []) + ([check["failed"]] if "failed" in check else []),
        "localised": {key: log[key] for key in ("verdict", "above") if key in log},
        "exports": {name: outcome(found) for name, found in export.get("targets", {}).items()},
        "broke": broke,
        "seconds": {"init": row["seconds"], **{step: row[step]["seconds"] for step in _AFTER if step in row}},
        "memory_mib": row["memory_mib"],
    }


def outcome(found: Mapping[str, Any]) -> str:
    """``agrees``, ``not run``, or ``refused: …`` and ``failed: …`` with the reason."""
    text = str(found["outcome"])
    return f"{text}: {found['reason']}" if "reason" in found else text


def line(row: Row) -> str:
    """One model for the console."""
    if not row:
        return "nothing to do without the step init"
    what = [row["status"], f"{row['package']}/{short(row['file'])}", f"{row['seconds']} s {row['memory_mib']:.0f} MiB"]
    what += [f"[{step['followed']}]" for step in row["steps"]]
    what += [] if row["read"] else [row.get("outside") or row["reason"]]
    for step in _AFTER:
        found = row.get(step, {})
        what += [f"{step}: {text}" for text in (*found.get("wrong", []), found.get("broke"), found.get("failed")) if text]
        what += [f"{name} {outcome(each)}" for name, each in found.get("targets", {}).items() if each["outcome"] == "failed"]
    return "  ".join(what)[:600]


def short(file: str) -> str:
    """The last two parts of a path."""
    return "/".join(file.split("/")[-2:])


def swept(rows: Sequence[Row]) -> dict[str, Any]:
    """Counts over further models, and those that went wrong."""
    found = published(rows)
    return {
        "models": len(found),
        "by_package": {name: dict(Counter(kind(row) for row in found if row["package"] == name)) for name in _names(found)},
        "worst": worst(found),
        "outside": dict(Counter(row["reason"].partition(":")[0] for row in found if row["status"] == "outside")),
        "peer_does_not_read": sum(row["read"] and not row["checked"] for row in found),
        "wrong": [_brief(row) for row in found if row["wrong"] or row["broke"] or kind(row) == NOT_READ],
        "seconds": max((row["seconds"]["init"] for row in found), default=0.0),
        "memory_mib": max((row["memory_mib"] for row in found), default=0.0),
    }


def _names(rows: Iterable[Row]) -> list[str]:
    return sorted({row["package"] for row in rows})


def _brief(row: Row) -> dict[str, str]:
    what = [*row["wrong"], *row["broke"].values(), *([row["reason"]] if kind(row) == NOT_READ else [])]
    return {"package": row["package"], "file": row["file"], "what": "; ".join(what)}


AT_ONCE, FOLLOWED, NOT_READ, OUTSIDE = "read", "refused, read after its remedy", "refused, not read", "outside"
KINDS = (AT_ONCE, FOLLOWED, NOT_READ, OUTSIDE)


def kind(row: Row) -> str:
    """One of :data:`KINDS`."""
    if row["status"] == "refused":
        return FOLLOWED if row["read"] else NOT_READ
    return str(row["status"])


def worst(rows: Iterable[Row]) -> dict[str, float]:
    """Largest difference of each figure."""
    found = list(rows)
    return {key: max((row["checked"][key] for row in found if key in row["checked"]), default=0.0) for key in SAME}


def table(result: Mapping[str, Any]) -> str:
    """Counts of all kinds."""
    rows = result["models"]
    counts = Counter(kind(row) for row in rows)
    lines = [("models", str(len(rows)))]
    lines += [(name, str(counts[name])) for name in KINDS]
    lines += [
        (f"– after {number} remed{'y' if number == 1 else 'ies'}", str(many))
        for number, many in sorted(Counter(len(row["remedies"]) for row in rows if kind(row) == FOLLOWED).items())
    ]
    reasons = Counter(row["reason"].partition(":")[0] for row in rows if row["status"] == "outside")
    lines += [(f"outside: {reason}", str(many)) for reason, many in reasons.most_common()]
    lines.append(("compared with MuJoCo or Pinocchio", str(sum(bool(row["checked"]) for row in rows))))
    lines += [(f"largest difference: {key.replace('_', ' ')}", f"{value:.2g}") for key, value in worst(rows).items()]
    lines.append(("different without a note", str(sum(bool(row["wrong"]) for row in rows))))
    lines.append(("log ingested and localised", str(sum(bool(row["localised"]) for row in rows))))
    if missing := sum(row["read"] and len(row["seconds"]) <= len(_AFTER) for row in rows):
        lines.append(("log or exports not tried in this run", str(missing)))
    lines.append(("traceback, crash, or a limit reached", str(sum(bool(row["broke"]) for row in rows))))
    lines.append(("largest processor time of init", f"{max((row['seconds']['init'] for row in rows), default=0.0):.1f} s"))
    lines.append(("largest memory of init", f"{max((row['memory_mib'] for row in rows), default=0.0):.0f} MiB"))
    return markdown(("", "number"), lines, "lr")


def export_table(rows: Sequence[Row]) -> str:
    """What became of the exports, by target."""
    names = list(dict.fromkeys(name for row in rows for name in row["exports"]))
    outcomes = ("agrees", "not run", "refused", "failed")
    cells = []
    for name in names:
        counts = Counter(row["exports"][name].partition(":")[0] for row in rows if name in row["exports"])
        cells.append((name, *(str(counts[each]) for each in outcomes)))
    return markdown(("target", "agrees with the plant", "simulator not here", "refused", "failed"), cells, "lrrrr")


def model_table(rows: Sequence[Row]) -> str:
    """One line a model."""
    return markdown(
        (
            "model",
            "status",
            "axes",
            "remedies or reason",
            "tip [m]",
            "torque",
            "mass matrix",
            "error / floor",
            "exports",
        ),
        (_cells(row) for row in rows),
        "llrlrrrrl",
    )


def _cells(row: Row) -> tuple[str, ...]:
    done = [*(f"`{step['followed']}`" for step in row["remedies"]), *(f"noted: {what}" for what in row["noted"])]
    text = "; ".join(done) if row["read"] else row["reason"]
    figures = [f"{row['checked'][key]:.1g}" if key in row["checked"] else "" for key in SAME]
    above = row["localised"].get("above")
    wrong = [*row["wrong"], *(f"{step}: {what}" for step, what in row["broke"].items())]
    counts = Counter(text.partition(":")[0] for text in row["exports"].values())
    exports = ", ".join(f"{what} {many}" for what, many in counts.items())
    return (
        f"{row['package']}: {short(row['file'])}",
        kind(row),
        "" if row["axes"] is None else str(row["axes"]),
        _cell("; ".join([text, *(f"**{what}**" for what in wrong)]) if wrong else text),
        *figures,
        "" if above is None else f"{above:.2f}",
        exports,
    )


def _cell(text: str) -> str:
    """Short, and without what ends a cell."""
    return (text if len(text) <= 220 else f"{text[:220]}…").replace("|", "\\|").replace("<", "&lt;").replace("\n", " ")


def sweep_table(found: Mapping[str, Any]) -> str:
    """Counts of the further models, by package."""
    cells = [(name, *(str(counts.get(each, 0)) for each in KINDS)) for name, counts in found["by_package"].items()]
    return markdown(("package", *KINDS), cells, "lrrrr")


def page(result: Mapping[str, Any]) -> str:
    """The page."""
    rows = result["models"]
    packages = ", ".join(f"{name} {text.partition(',')[0]}" for name, text in result["packages"].items())
    refusals = sorted(
        {(name, text) for row in rows for name, text in row["exports"].items() if text.startswith(("refused", "failed"))}
    )
    parts = [
        "# Robot models of others",
        f"Written by `make robots`, which runs `{result['command']}`, {result['date']}, commit {result['commit']}, "
        f"{result['machine']}. All figures are in [`result.json`](result.json).",
        f"Packages: {packages}. Their models are not copied: [`pipelines/robots_corpus/corpus.toml`]"
        "(../../pipelines/robots_corpus/corpus.toml) has their names, versions and licences.",
        "## Summary",
        table(result),
        "- **read**: `sysid init OUT --from FILE` makes a machine of it without further options. **refused**: it asks for"
        " something; a program followed its remedy to the letter, up to three times. **outside**: an independent reader"
        " confirms that the model is no open chain of driven joints. A URDF that does not say how its joints are commanded is"
        " always refused once: `--kind` says it.",
        "- The **tip** is compared in metres, the **torque** against gravity and the **mass matrix** relative to their largest"
        " entry, at 20 random poses within the limits: with MuJoCo for MJCF (without rotor inertias), with Pinocchio on the"
        f" original text of a URDF. Equal is up to {SAME['tip_m']:g} m and {SAME['torque']:g}.",
        f"- Each `init` has {LIMITS.cpu} s of processor time and {(LIMITS.memory or 0) / 1e9:g} GB of memory.",
        "- **error / floor**: the largest error that `sysid gap --localise` finds in a log of the machine's own nominal"
        " simulation, over its noise floor. About 1 is no gap.",
        "## Exports",
        export_table(rows),
        "An arm of forces with masses is exported to the targets that write masses. Reasons:",
        "\n".join(f"- {name} {_cell(text)}" for name, text in _distinct(refusals)),
        "## Models",
        model_table(rows),
    ]
    if "others" in result:
        others = result["others"]
        parts += [
            "## Further models of these packages",
            f"{others['models']} files with the root element `robot` or `mujoco` that the list does not have, read and compared"
            " as above, without logs and exports. Largest differences: "
            + ", ".join(f"{key.replace('_', ' ')} {value:.2g}" for key, value in others["worst"].items())
            + f". Largest processor time {others['seconds']:.1f} s, memory {others['memory_mib']:.0f} MiB.",
            sweep_table(others),
            markdown(
                ("outside", "number"), [(r, str(n)) for r, n in sorted(others["outside"].items(), key=lambda i: -i[1])], "lr"
            ),
        ]
        if others["wrong"]:
            cells = [(f"{r['package']}: {short(r['file'])}", _cell(r["what"])) for r in others["wrong"]]
            parts += [
                "Refused without a remedy that works, or different without a note:",
                markdown(("model", "what"), cells, "ll"),
            ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _distinct(refusals: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """One refusal for each target and sort of reason: without names and numbers."""
    found: dict[tuple[str, str], tuple[str, str]] = {}
    for name, text in refusals:
        sort = "".join(letter for letter in text.partition(";")[2] if letter.isalpha())[:60]
        found.setdefault((name, sort), (name, text))
    return list(found.values())
