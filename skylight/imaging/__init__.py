"""Photographs, films, colour and image metrics."""
