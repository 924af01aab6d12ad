"""The links of an arm on its force axes: whole-arm motion → payload, masses of links, and adjusted inertial parameters.

``forces`` leaves friction out of a comparison, ``posture`` asks for masses, ``rows`` are the regression, ``stage`` decides.
"""
