"""Inverse lighting: observations, a light model and a prior to an estimate."""
