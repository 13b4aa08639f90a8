"""Evaluations of sky models."""
