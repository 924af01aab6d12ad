"""A user's simulator in the gap workflow: its adapter with effects at inputs and outputs, and a surrogate model of it."""
