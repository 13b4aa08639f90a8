"""Albedos by a ColorChecker in the same photograph."""
