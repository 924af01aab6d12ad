"""The checks of the supervisor."""
