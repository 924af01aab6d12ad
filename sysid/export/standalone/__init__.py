"""Equations of a plant in plain Python and NumPy, from which the shipped drive model is assembled; none imports ``sysid``."""
