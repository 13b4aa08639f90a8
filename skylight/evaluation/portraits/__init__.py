"""Evaluations of portraits in another light."""
