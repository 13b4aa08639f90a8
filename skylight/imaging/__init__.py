"""Photographs, colour and image metrics."""
