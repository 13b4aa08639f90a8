"""Faces: photograph to observation by landmarks, head model, fit, skin and segmentation."""
