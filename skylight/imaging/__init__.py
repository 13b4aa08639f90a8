"""Photographs and films in linear light: colour, capture metadata, image metrics."""
