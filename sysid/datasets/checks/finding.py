"""What a check says about a dataset: what was found, what was expected, the likely causes, and what to change."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatchcase
from typing import Any, Literal

from sysid.errors import InputError, nearest
from sysid.names import listed

#: ``severe``: certain to be wrong, `sysid gap` does not run. ``notice``: unusual; it may be right.
Severity = Literal["severe", "notice"]
#: Most names in a sentence; the others are counted.
MOST_NAMES = 4


@dataclass(frozen=True)
class Cause:
    """A mistake that explains a finding: ``<about> <subjects> is <says>``.

    Args:
        about: before the subjects, such as "`gain` of axis"; may stand alone.
        subjects: signals or axes with the mistake.
        says: what they are, after "is" or "are".
        factor: by which the value as it was read is too large; −1 for a sign, 1 where no factor is concerned.
        remedy: what to change.
    """

    about: str
    subjects: tuple[str, ...]
    says: str
    factor: float = 1.0
    remedy: str = ""

    @property
    def text(self) -> str:
        axis, several = self.about.endswith("axis"), len(self.subjects) > 1
        plural = several or " and " in self.about or (self.about.endswith("s") and not axis)
        about = f"{self.about[:-4]}axes" if several and axis else self.about
        words = (about, listed(self.subjects, MOST_NAMES), "are" if plural else "is", self.says)
        return " ".join(word for word in words if word)

    def joined(self, other: Cause) -> Cause:
        """This cause for the subjects of an equal one as well."""
        return replace(self, subjects=tuple(dict.fromkeys((*self.subjects, *other.subjects))))

    def to_json(self) -> dict[str, Any]:
        return {"text": self.text, "factor": self.factor, "subjects": list(self.subjects), "remedy": self.remedy}


def opposite_sign(*signals: str, remedy: str = "Set `sign = -1` in the recipe") -> Cause:
    """Signals with the wrong sign."""
    return Cause("", signals, "of the opposite sign", -1.0, remedy)


def exchanged_columns(*signals: str, remedy: str = "Correct the recipe") -> Cause:
    """Columns of the log that are taken for each other."""
    return Cause("the columns", signals, "exchanged", 1.0, remedy)


@dataclass(frozen=True)
class Evidence:
    """What was found, and what was expected: numbers with units."""

    found: str
    expected: str

    @property
    def text(self) -> str:
        return f"{self.found}; expected {self.expected}"


@dataclass(frozen=True)
class Finding:
    """One implausible thing in a dataset.

    Args:
        keys: stable names, ``<axis or signal>:<kind>``, which ``--accept`` takes. Several where axes have the same mistake.
        causes: the likeliest first. Several where the data cannot decide between them; empty where no known mistake fits.
        recordings: those concerned; empty: all.
    """

    keys: tuple[str, ...]
    severity: Severity
    evidence: tuple[Evidence, ...]
    causes: tuple[Cause, ...] = ()
    recordings: tuple[str, ...] = ()

    @property
    def lines(self) -> tuple[str, ...]:
        """The finding without its keys: evidence, recordings, causes."""
        lines = [evidence.text for evidence in self.evidence]
        if self.recordings:
            lines.append(f"in {listed(self.recordings, MOST_NAMES)}")
        for number, cause in enumerate(self.causes):
            lines.append(f"{'or' if number else 'likely cause'}: {cause.text}{f'. {cause.remedy}' if cause.remedy else ''}")
        return tuple(lines)

    @property
    def kinds(self) -> set[str]:
        """The ends of its keys."""
        return {key.rpartition(":")[2] for key in self.keys}

    def accepted(self, patterns: Iterable[str]) -> bool:
        """Whether the patterns name every key."""
        patterns = tuple(patterns)
        return all(any(fnmatchcase(key, pattern) for pattern in patterns) for key in self.keys)

    def to_json(self) -> dict[str, Any]:
        return {
            "keys": list(self.keys),
            "severity": self.severity,
            "evidence": [asdict(evidence) for evidence in self.evidence],
            "causes": [cause.to_json() for cause in self.causes],
            "recordings": list(self.recordings),
        }


def not_accepted(findings: Sequence[Finding], accept: Sequence[str]) -> tuple[Finding, ...]:
    """The severe findings that ``accept`` does not name.

    Args:
        accept: keys, or globs such as ``boom.*``.

    Raises:
        InputError: a pattern that names no finding.
    """
    keys = sorted(key for finding in findings for key in finding.keys)
    for pattern in accept:
        if not any(fnmatchcase(key, pattern) for key in keys):
            known = nearest(pattern, keys) if keys else "none, since nothing implausible was found"
            raise InputError(f"--accept {pattern}", "no finding has this key", known)
    return tuple(finding for finding in findings if finding.severity == "severe" and not finding.accepted(accept))


def refuse_severe(findings: Sequence[Finding], accept: Sequence[str], where: object) -> None:
    """Stop where severe findings are not accepted.

    Raises:
        InputError: severe findings that ``accept`` does not name, or a pattern that names no finding.
    """
    left = not_accepted(findings, accept)
    if left:
        options = " ".join(f"--accept '{key}'" for finding in left for key in finding.keys)
        briefs = "; ".join(each.causes[0].text if each.causes else each.evidence[0].text for each in left)
        raise InputError(
            where,
            f"{len(left)} severe finding{'s' if len(left) > 1 else ''}: {briefs}",
            remedy=f"Correct the recipe or machine.toml and ingest again. If the values are right, add {options}",
        )


def plain(number: float) -> str:
    """Three significant digits without an exponent from 1e-4 to 1e6: ``1100``, ``57.3``, ``0.0005``."""
    rounded = float(f"{number:.3g}")
    return f"{rounded:.0f}" if abs(rounded) >= 1000.0 else f"{rounded:g}"


def factor_text(factor: float) -> str:
    """``1000.0`` → "too large by a factor of 1000"; ``0.001`` → "too small by a factor of 1000"."""
    size = plain(factor if factor >= 1.0 else 1.0 / factor)
    return f"too {'large' if factor >= 1.0 else 'small'} by a factor of {size}"


def with_unit(number: float | str, unit: str | None = None) -> str:
    """A value in SI, with four significant digits."""
    text = number if isinstance(number, str) else f"{number:.4g}"
    return f"{text} {unit}" if unit and unit != "1" else text


def interval(low: float, high: float, unit: str | None = None) -> str:
    return with_unit(f"[{low:.4g}, {high:.4g}]", unit)


def ratio_text(ratio: float) -> str:
    """``1000 times``, ``1/57.3 of``."""
    return f"{plain(ratio)} times" if ratio >= 1.0 else f"1/{plain(1.0 / ratio)} of"
