"""Stages of a whole arm: links on force axes, static poses, servos, and sag under the weight of the links.

Links: ``forces`` leaves friction out of a comparison, ``posture`` asks for masses, ``link_rows`` are the regression, and
``link_stage`` decides on payload, masses of links and adjusted inertial parameters. Static poses: ``pose_folds`` deals them to
fit, selection and test, ``pose_rows`` are the regression beside small errors of the arm, and ``pose_stage`` decides. Both
decide on ``effect_sets``. ``servos`` move one arm together; ``sag`` of a position axis, and ``sag_ties`` with its sensor.
"""
