"""Trained models that evaluations use, each read once a process."""

from functools import cache
from pathlib import Path

from skylight.models.autoencoder import AutoencoderLight
from skylight.models.bundle import LightBundle, load_bundle


@cache
def trained_model(folder: Path | None) -> LightBundle:
    """The model of that folder; None for the one that comes with skylight."""
    return load_bundle(folder)


@cache
def trained_light(folder: Path | None) -> AutoencoderLight:
    """Its light model, shared: do not modify it."""
    return trained_model(folder).light()
