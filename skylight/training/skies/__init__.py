"""Training skies: read, varied, coded, drawn in batches."""
