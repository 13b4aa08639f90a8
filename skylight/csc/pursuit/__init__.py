"""Sparse solvers: quadratic objectives, greedy pursuit, refits and exchanges."""
