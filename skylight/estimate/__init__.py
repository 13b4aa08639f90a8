"""Illumination from photographs of faces: results, reports, folders."""
