"""Evaluations of light estimated from faces."""
