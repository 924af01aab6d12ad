"""A MuJoCo model in the gap workflow: its runs, what is identified inside it, and the repaired MJCF."""
