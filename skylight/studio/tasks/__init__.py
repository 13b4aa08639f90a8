"""Tasks of the studio, run in worker processes."""
