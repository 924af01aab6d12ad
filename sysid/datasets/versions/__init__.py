"""Dataset versions: written once, addressed by content, appended to, compared, traced and cleared away."""
