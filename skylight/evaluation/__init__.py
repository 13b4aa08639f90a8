"""Evaluations: the thesis' tables and others, how they are run and written."""
