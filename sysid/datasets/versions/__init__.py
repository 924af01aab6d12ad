"""Dataset versions: immutable and addressed by content, with append, comparison, lineage and removal."""
