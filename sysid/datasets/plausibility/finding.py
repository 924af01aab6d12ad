"""What a check of plausibility found."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from typing import Any, Literal

from sysid.errors import InputError

#: ``severe``: certain to be wrong, `sysid gap` does not run. ``notice``: unusual; it may be right.
Severity = Literal["severe", "notice"]


@dataclass(frozen=True)
class Cause:
    """A mistake that explains a finding.

    Args:
        text: what is wrong, in words.
        factor: by which the value as it was read is too large; −1 for a sign, 1 where no factor is concerned.
        remedy: what to change.
    """

    text: str
    factor: float
    remedy: str = ""

    def with_subject(self, other: Cause) -> Cause:
        """This cause and the equal one of another axis: ``a.x is in mm`` and ``b.x is in mm`` → ``a.x, b.x: …``."""
        return self if other == self else Cause(f"{self.text}; {other.text}", self.factor, self.remedy)


@dataclass(frozen=True)
class Finding:
    """One implausible thing in a dataset.

    Args:
        keys: stable names, ``<axis or signal>:<kind>``, which ``--accept`` takes. Several where axes have the same mistake.
        recordings: those concerned; empty: all.
        found, expected: numbers with units.
        causes: the likeliest first. Several where the data cannot decide between them; empty where no known mistake fits.
    """

    keys: tuple[str, ...]
    severity: Severity
    found: str
    expected: str
    causes: tuple[Cause, ...] = ()
    recordings: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        return self.keys[0].rpartition(":")[2]

    @property
    def text(self) -> str:
        """The finding in one paragraph, without its keys."""
        parts = [f"{self.found}; expected {self.expected}." if self.expected else f"{self.found}."]
        if self.recordings:
            parts.append(f"In {listed(self.recordings)}.")
        if self.causes:
            parts.append(f"Likely cause: {', or '.join(cause.text for cause in self.causes)}.")
            parts += [f"{cause.remedy}." for cause in self.causes if cause.remedy]
        return " ".join(dict.fromkeys(parts))

    def accepted(self, patterns: Iterable[str]) -> bool:
        """Whether the patterns name every key."""
        patterns = tuple(patterns)
        return all(any(fnmatchcase(key, pattern) for pattern in patterns) for key in self.keys)

    def to_json(self) -> dict[str, Any]:
        return {
            "keys": list(self.keys),
            "severity": self.severity,
            "found": self.found,
            "expected": self.expected,
            "causes": [asdict(cause) for cause in self.causes],
            "recordings": list(self.recordings),
            "text": self.text,
        }


def listed(names: Sequence[str], most: int = 4) -> str:
    """``a, b and c``; more than ``most`` are counted."""
    if len(names) > most:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def refuse_severe(findings: Sequence[Finding], accept: Sequence[str], where: object) -> None:
    """Stop where severe findings are not accepted.

    Args:
        accept: keys, or globs such as ``boom.*``.

    Raises:
        InputError: severe findings that no pattern names, or a pattern that names no finding.
    """
    keys = sorted(key for finding in findings for key in finding.keys)
    for pattern in accept:
        if not any(fnmatchcase(key, pattern) for key in keys):
            known = f"one of: {', '.join(keys)}" if keys else "none: nothing implausible was found"
            raise InputError(f"--accept {pattern}", "no finding has this key", known)
    left = [finding for finding in findings if finding.severity == "severe" and not finding.accepted(accept)]
    if not left:
        return
    lines = "".join(f"\n  {', '.join(finding.keys)}: {finding.text}" for finding in left)
    options = " ".join(f"--accept {key}" for finding in left for key in finding.keys)
    raise InputError(
        where,
        f"{len(left)} severe finding{'s' if len(left) > 1 else ''}:{lines}\n",
        "plausible values",
        "Correct the recipe or machine.toml and ingest again (docs/guide/wrong-data.md). If the values are right, continue "
        f"with: {options}",
    )
