"""Structure that no effect of the catalogue explains: a formula that describes it, or a residual model that predicts it."""
