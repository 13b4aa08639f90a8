"""Portraits in another light; files to files."""
