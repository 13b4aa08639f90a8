"""Illumination from objects of known shape; files to files."""
