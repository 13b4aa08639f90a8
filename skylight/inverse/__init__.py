"""Observation + light model + prior -> estimate."""
