"""Uncertainty of a fit: values at the exact optimum and 95 % intervals; their coverage is in ``docs/intervals.md``.

Reading order: ``criterion`` (cost of a parameter vector), ``curvature`` (slopes, correlated residuals), ``settle`` (exact
optimum), ``input_noise`` (noise in a measured input), ``shared`` (errors of zeros and mounts), ``profile`` (profile
likelihood), ``known`` (all of it for a fit), ``jackknife`` (wrong formulas: differences between parts of the recordings).
"""

from sysid.gap.intervals.jackknife import jackknifed
from sysid.gap.intervals.known import Known, known_of

__all__ = ["Known", "jackknifed", "known_of"]
