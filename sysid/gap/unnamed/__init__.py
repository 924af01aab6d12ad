"""Structure that no effect of the catalogue explains, and what may stand in place of names.

``residual_series``: a residual, and the variables and terms it may depend on. ``periodic``: ripples, resonances, disturbances
periodic in time. ``formula``: a sum of terms. ``description``: what the user reads. ``residual_model``: a network.
``instead``: names that a periodic disturbance or a function of the position explains better.
"""
