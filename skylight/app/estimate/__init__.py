"""Illumination from photographs and films of faces: results, reports, batches, a demonstration."""
