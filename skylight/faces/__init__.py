"""Faces: head model, landmarks, fitting, skin."""
