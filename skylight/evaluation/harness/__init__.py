"""Runs, tables and figures of all evaluations."""
