"""Folders of simulated and captured skies."""
