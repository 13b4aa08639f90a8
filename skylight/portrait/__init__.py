"""Portraits in another light."""
