"""Position axes under load: whether their gravity load is known, and their error at rest."""
