"""``skylight train``: a light model from a folder of skies."""

from dataclasses import fields, replace
from pathlib import Path

from tyro.conf import Positional

from skylight._options import take_care
from skylight.errors import InputError
from skylight.work._device import Device


def train(
    folder: Positional[Path | None] = None,
    out: Path | None = None,
    config: str = "sky_autoencoder",
    network: str | None = None,
    epochs: int | None = None,
    device: Device | None = None,
) -> None:
    """Train a light model on a folder of skies: one command to a folder that --model takes.

    Indexes FOLDER as `skylight skies index` does (unless it has an index already), trains the sky
    autoencoder, fits the priors, and writes network, priors and model card into OUT. The same
    command goes on with a run that was interrupted.

    Without FOLDER, runs a configuration as `python train.py` does (see docs/commands.md), and then
    fits the priors to its skies, so that a network of any kind ends as a folder for --model.

    Args:
        folder: Folder of .exr or .hdr maps of skies, or one that `skylight skies simulate` wrote.
        out: Folder for the model.
        config: Name of a configuration that comes with skylight (sky_autoencoder,
            sky_autoencoder_thesis, sky_prior, csc_dictionary), or a .yaml file.
        network: A class of your own in place of the configuration's network: module:Class.
        epochs: Passes over the training skies, if not those of the configuration.
        device: auto (CUDA where it is), cpu or cuda, if not that of the configuration.
    """
    from skylight.training._config import AutoencoderConfig, find_config, read_config
    from skylight.training._run import light_model, run, train_folder
    from skylight.work._progress import stage_bar, with_time_left

    settings = read_config(find_config(config))
    if folder is None:
        options = {"out": out, "network": network, "epochs": epochs, "device": device}
        changes = {name: value for name, value in options.items() if value is not None}
        if unknown := changes.keys() - {field.name for field in fields(settings)}:
            raise InputError(
                f"--config {config}: a configuration of kind {settings.kind} has no "
                f"{' and no '.join(sorted(unknown))}; leave --{' and --'.join(sorted(unknown))} out"
            )
        settings = replace(settings, **changes)
        run(settings)
        if isinstance(settings, AutoencoderConfig):
            try:
                light_model(settings)
            except InputError as error:  # skies that suffice for a network alone
                take_care(f"no folder for --model was made of it: {error}")
            else:
                print(f"{settings.out}: a light model; its card is {settings.out / 'card.md'}")
        return
    if out is None:
        raise InputError("--out is missing: name the folder for the model")
    if not isinstance(settings, AutoencoderConfig):
        raise InputError(
            f"--config {config}: a configuration of kind {settings.kind} trains no light model; "
            "leave FOLDER out to run it, or choose sky_autoencoder"
        )
    with stage_bar() as progress:
        train_folder(
            folder,
            out,
            replace(
                settings, device=device or settings.device, network=network or settings.network
            ),
            epochs=epochs,
            progress=with_time_left("map", progress),
        )
    print(f"{out}: a light model; its card is {out / 'card.md'}")
