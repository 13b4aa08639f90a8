"""The command line of ``train.py``."""

import os
import sys

import tyro

from skylight.errors import InputError, SkylightError
from skylight.training.config import (
    AutoencoderConfig,
    Config,
    DictionaryConfig,
    find_config,
    read_config,
)


def main(arguments: list[str] | None = None) -> None:
    """``train.py CONFIG [--key value ...]``: overrides are checked against the configuration.

    ``torchrun --nproc-per-node N train.py CONFIG`` trains in N processes on one machine.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    rank = int(os.environ.get("RANK", "0"))
    name = f"train.py, process {rank}" if rank else "train.py"
    try:
        if not arguments or arguments[0].startswith("-"):
            raise InputError("usage: python train.py configs/NAME.yaml [--key value ...]")
        config = read_config(find_config(arguments[0]))
        config = tyro.cli(type(config), default=config, args=arguments[1:], prog="train.py")
        run(config)
    except SkylightError as error:
        print(f"{name}: {error}", file=sys.stderr)
        raise SystemExit(error.exit_code) from None
    except OSError as error:  # a folder that cannot be made or written
        print(f"{name}: {error}", file=sys.stderr)
        raise SystemExit(1) from None
    except KeyboardInterrupt:
        print(f"{name}: interrupted; the same command goes on from here", file=sys.stderr)
        raise SystemExit(1) from None
    if "LOCAL_RANK" in os.environ:
        # gloo's threads outlive its process group now and then, and ending Python would abort then
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)


def run(config: Config) -> None:
    """Do what a configuration says, and print where the result is."""
    if isinstance(config, AutoencoderConfig):
        from skylight.training.autoencoder import train

        best = train(config)
        if os.environ.get("RANK", "0") == "0":
            print(f"best network: {best}")
    elif isinstance(config, DictionaryConfig):
        from skylight.training.dictionary import learn_dictionary

        print(f"dictionary: {learn_dictionary(config)}")
    else:
        from skylight.training.prior import fit_priors

        print(f"light model: {fit_priors(config)}")
