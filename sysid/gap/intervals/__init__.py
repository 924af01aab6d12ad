"""Uncertainty of a fit: values at the exact optimum and 95 % intervals; their coverage is in ``docs/intervals.md``.

Reading order: ``criterion`` (cost of a parameter vector, its slopes, correlated residuals), ``input_noise`` (noise in a
measured input), ``profile`` (profile likelihood), ``known`` (exact optimum, errors of zeros and mounts, all of it for a fit).
What parts of the recordings differ by, where formulas are wrong, is in :mod:`sysid.gap.stage_intervals`.
"""

from sysid.gap.intervals.known import Known, known_of

__all__ = ["Known", "known_of"]
