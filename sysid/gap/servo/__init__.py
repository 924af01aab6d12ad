"""Position axes: ``sag`` under a gravity load, its ``ties`` with errors of the sensor, and servos that move one ``arm``."""
