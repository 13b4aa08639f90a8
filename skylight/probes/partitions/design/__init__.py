"""Designs of the partitions probe, and their optimisation."""
