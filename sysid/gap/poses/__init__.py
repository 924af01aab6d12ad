"""The end-effector stage of a dataset of static poses alone: kinematic calibration as a choice among effects.

``folds`` deals poses to fit, selection and test; ``rows`` are the poses as a linear regression, beside small errors of the arm;
``stage`` goes from poses to a decision.
"""
