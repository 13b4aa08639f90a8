"""Skies: simulated days, and folders of captured ones."""
