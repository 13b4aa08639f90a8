"""``skylight train``: a light model from a folder of skies, or a run of a configuration."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from skylight._options import take_care
from skylight.errors import InputError
from skylight.work._device import Device


def train(
    folder: Positional[Path | None] = None,
    overrides: Annotated[Positional[tuple[str, ...]], arg(metavar="[KEY=VALUE ...]")] = (),
    out: Path | None = None,
    config: str = "sky_autoencoder",
    network: str | None = None,
    epochs: int | None = None,
    device: Device | None = None,
    keys: bool = False,
) -> None:
    """Train a light model on a folder of skies: one command to a folder that --model takes.

    Indexes FOLDER as `skylight skies index` does (unless it has an index already), trains the sky
    autoencoder, fits the priors, and writes network, priors and model card into OUT. The same
    command goes on with a run that was interrupted, or that has ended and gets more epochs.

    Without FOLDER, runs a configuration as `python train.py` does (see docs/commands.md), and then
    fits the priors to its skies, so that a network of any kind ends as a folder for --model.

    Args:
        folder: Folder of .exr or .hdr maps of skies, or one that `skylight skies simulate` wrote.
        overrides: Keys of the configuration, as batch=16 learning_rate=3e-4; --keys lists them.
        out: Folder for the model.
        config: Name of a configuration that comes with skylight (sky_autoencoder,
            sky_autoencoder_thesis, sky_prior, csc_dictionary, sphere), or a .yaml file.
        network: A class of your own in place of the configuration's network: module:Class.
        epochs: Passes over the training skies, if not those of the configuration.
        device: auto (CUDA where it is), cpu or cuda, if not that of the configuration.
        keys: List the keys of the configuration with their values and meanings, and do no more.
    """
    from skylight.training._config import AutoencoderConfig, find_config, read_config
    from skylight.training._overrides import keys_page, read_overrides
    from skylight.training._run import LOG_EVERY_S, light_model, run, train_folder
    from skylight.work._progress import stage_bar

    settings = read_config(find_config(config))
    if keys:
        print(*keys_page(settings), sep="\n")
        return
    texts = [] if folder is None else [str(folder), *overrides]
    folders = [Path(each) for each in texts if "=" not in each or Path(each).is_dir()]
    if len(folders) > 1:
        raise InputError(f"give one FOLDER, not {' and '.join(map(str, folders))}")
    folder = folders[0] if folders else None
    texts = [each for each in texts if Path(each) not in folders]
    options = {"out": out, "network": network, "epochs": epochs, "device": device}
    changes: dict[str, Any] = {name: each for name, each in options.items() if each is not None}
    if unknown := changes.keys() - {field.name for field in fields(settings)}:
        raise InputError(
            f"--config {config}: a configuration of kind {settings.kind} has no "
            f"{' and no '.join(sorted(unknown))}; leave --{' and --'.join(sorted(unknown))} out"
        )
    given = read_overrides(type(settings), texts)
    if twice := sorted(changes.keys() & given):
        raise InputError(f"{twice[0]}= and --{twice[0]} are both given; leave one of them out")
    changes |= given
    if folder is None:
        settings = replace(settings, **changes)
        run(settings)
        if isinstance(settings, AutoencoderConfig):
            try:
                with stage_bar(log_every_s=LOG_EVERY_S) as progress:
                    light_model(settings, progress)
            except InputError as error:  # skies that suffice for a network alone
                take_care(f"no folder for --model was made of it: {error}")
            else:
                print(f"{settings.out}: a light model; its card is {settings.out / 'card.md'}")
        return
    if not isinstance(settings, AutoencoderConfig):
        raise InputError(
            f"--config {config}: a configuration of kind {settings.kind} trains no light model; "
            "leave FOLDER out to run it, or choose sky_autoencoder"
        )
    if "data" in changes:
        raise InputError(f"data= and FOLDER {folder} are both given; leave one of them out")
    if "out" not in changes:
        raise InputError("--out is missing: name the folder for the model")
    model = changes.pop("out")
    with stage_bar(log_every_s=LOG_EVERY_S) as progress:
        train_folder(
            folder,
            model,
            settings,
            changes,
            progress=progress,
        )
    print(f"{model}: a light model; its card is {model / 'card.md'}")
