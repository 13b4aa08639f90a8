"""Evaluations of sparse codes."""
