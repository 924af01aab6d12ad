"""How well a fit knows its parameters: values at the exact optimum, 95 % intervals, and the covariance that goes with them.

Reading order: ``criterion`` (what a parameter vector costs), ``curvature`` (slopes, and how correlated residuals widen),
``settle`` (the exact optimum), ``input_noise`` (what noise in a measured input does), ``shared`` (what zeros and mounts do that
are off), ``profile`` (how far each parameter may go), ``known`` (all of it for a fit). How often the intervals hold the truth:
``docs/intervals.md``.
"""

from sysid.gap.intervals.known import Known, known_of

__all__ = ["Known", "known_of"]
