"""Illumination from photographs of faces: results, reports, batches, a demonstration."""
