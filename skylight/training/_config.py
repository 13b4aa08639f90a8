"""Configurations of training runs: YAML with overrides from the command line."""

import reprlib  # which stays short: YAML makes much of little
from dataclasses import asdict, dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import yaml

from skylight.errors import InputError
from skylight.io._bounded import file_text


@dataclass(frozen=True, kw_only=True)
class AutoencoderConfig:
    """A run of the sky autoencoder.

    ``network`` is the kind: "splines" with so many ``latents``, or the thesis' "convolutions",
    with 64, to which ``coding`` and ``sun`` (whether the sun has coordinates of its own) belong.

    ``energy_weight``, ``squared_weight``, ``scale_invariant`` and ``latent_penalty`` are weights of
    the loss: see ``reconstruction_loss``. ``noise_sigma`` (of coded radiance), ``masked`` (the
    probability that a block is hidden), ``sun_noise`` (of the sun's coordinates) and
    ``latent_noise`` corrupt what the network sees: see ``draw_corruption``.

    ``surroundings`` is the probability that a scene stands before a sky, ``tint`` the spread of
    white balances, ``white_balance`` how far they go at most towards a grey mean, ``mirror``
    whether every other sky is mirrored. So many ``copies`` of every sky
    are varied by them, and shown in turn, one an epoch.

    ``bfloat16`` is mixed precision where the device has it. ``batch`` is that of all processes
    together. ``momentum`` and ``nesterov`` are of ``optimiser: sgd``. ``starts_from`` names a
    checkpoint with the initial weights. A ``gradient_clip`` of 0 clips nothing; ``threads`` 0
    leaves their number to torch.
    """

    kind: Literal["autoencoder"] = "autoencoder"
    data: Path = Path("runs/skies")
    out: Path = Path("runs/sky_autoencoder")
    starts_from: Path | None = None
    network: Literal["splines", "convolutions"] = "splines"
    latents: int = 64
    coding: Literal["log", "linear"] = "log"
    sun: bool = True
    noise_sigma: float = 0.01
    masked: float = 0.0
    sun_noise: float = 0.0
    latent_noise: float = 0.0
    energy_weight: float = 0.3
    squared_weight: float = 0.0
    scale_invariant: float = 0.0
    latent_penalty: float = 0.0
    mirror: bool = True
    surroundings: float = 0.0
    tint: float = 0.0
    white_balance: float = 0.0
    copies: int = 1
    epochs: int = 60
    batch: int = 32
    optimiser: Literal["adamw", "sgd"] = "adamw"
    learning_rate: float = 0.001
    schedule: Literal["cosine", "constant"] = "cosine"
    warmup_steps: int = 200
    momentum: float = 0.9
    nesterov: bool = True
    weight_decay: float = 1e-5
    gradient_clip: float = 1.0
    patience: int = 12
    checkpoint_steps: int = 100
    bfloat16: bool = True
    compile: bool = False
    threads: int = 0
    device: str = "auto"
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("epochs", "batch", "checkpoint_steps", "patience", "copies"):
            if getattr(self, name) < 1:
                raise InputError(f"`{name}` must be at least 1, got {getattr(self, name)}")
        for name in (
            *("noise_sigma", "energy_weight", "scale_invariant", "weight_decay"),
            *("gradient_clip", "warmup_steps", "momentum", "threads", "tint", "sun_noise"),
            *("squared_weight", "latent_penalty", "latent_noise"),
        ):
            if getattr(self, name) < 0:
                raise InputError(f"`{name}` must be at least 0, got {getattr(self, name)}")
        if not 0 <= self.seed < 10_000_000:  # of which steps' seeds are made, in 64 bits
            raise InputError(f"`seed` must be from 0 to 9999999, got {self.seed}")
        for name in ("surroundings", "masked", "white_balance"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"`{name}` must be from 0 to 1, got {getattr(self, name)}")
        if self.optimiser == "sgd" and self.nesterov and self.momentum == 0:
            raise InputError("`nesterov` needs a `momentum` above 0; give one, or nesterov: false")
        if self.network == "splines" and (self.coding, self.sun) != ("log", True):
            raise InputError("`coding` and `sun` are choices of network: convolutions alone")
        least, most = (64, 64) if self.network == "convolutions" else (8, 512)
        if not least <= self.latents <= most:
            raise InputError(
                f"`latents` of network: {self.network} must be from {least} to {most}, "
                f"got {self.latents}"
            )


@dataclass(frozen=True, kw_only=True)
class PriorConfig:
    """A fit of the mixtures over latents and over Sun+Sky parameters."""

    kind: Literal["prior"] = "prior"
    data: Path = Path("runs/skies")
    checkpoint: Path = Path("runs/sky_autoencoder/model.safetensors")
    out: Path = Path("runs/sky_prior")
    most_components: int = 8
    bank: int = 480
    seed: int = 0

    def __post_init__(self) -> None:
        if self.most_components < 1 or self.bank < 24:
            raise InputError("`most_components` must be at least 1 and `bank` at least 24")


@dataclass(frozen=True, kw_only=True)
class DictionaryConfig:
    """Learning filters for sparse codes from a folder of light probes.

    ``maps`` names the files to take and ``category`` how theirs in index.csv begins; empty, both
    take all. ``filters`` counts the learned ones. From ``rows`` on all is of the method "gradient":
    maps of so many rows, coded by ``activations``, filters of ``radius_deg`` that may be negative
    where ``signed``.
    """

    kind: Literal["dictionary"] = "dictionary"
    data: Path = Path("runs/probes")
    out: Path = Path("runs/dictionary")
    method: Literal["kmeans", "gradient"] = "gradient"
    filters: int = 100
    category: str = ""
    maps: tuple[str, ...] = ()
    degree: int = 40
    seed: int = 0
    rows: int = 32
    activations: int = 36
    epochs: int = 1
    radius_deg: float = 30.0
    signed: bool = False

    def __post_init__(self) -> None:
        for name in ("filters", "activations", "epochs"):
            if getattr(self, name) < 1:
                raise InputError(f"`{name}` must be at least 1, got {getattr(self, name)}")
        if self.degree < 3:
            raise InputError(f"`degree` must be at least 3, got {self.degree}")
        if not (self.degree + 1) ** 2 <= 2 * self.rows**2 or self.rows >= 64:
            raise InputError(
                f"`rows` must be below 64, and 2 rows^2 at least (degree + 1)^2 = "
                f"{(self.degree + 1) ** 2}, got {self.rows}"
            )
        if not 0 < self.radius_deg <= 90:
            raise InputError(f"`radius_deg` must be above 0, at most 90, got {self.radius_deg}")
        if not 0 <= self.seed < 2**32:  # NumPy's
            raise InputError(f"`seed` must be from 0 to {2**32 - 1}, got {self.seed}")


Config = AutoencoderConfig | PriorConfig | DictionaryConfig
_KINDS: dict[str, type[Config]] = {
    "autoencoder": AutoencoderConfig,
    "prior": PriorConfig,
    "dictionary": DictionaryConfig,
}


def find_config(name: str) -> Path:
    """The file of a configuration: ``name`` is its path, or one that comes with skylight.

    Raises
    ------
    InputError
        Neither; the line names those that come with skylight.
    """
    if name.endswith((".yaml", ".yml")) or Path(name).parent != Path():
        return Path(name)
    packed = Path(str(files("skylight.training") / "configs"))  # in a wheel; see setup.py
    folder = packed if packed.is_dir() else Path(__file__).parents[2] / "configs"
    if not (folder / f"{name}.yaml").is_file():
        known = ", ".join(sorted(path.stem for path in folder.glob("*.yaml")))
        raise InputError(f"no configuration {name!r}: choose one of {known}, or give a .yaml file")
    return folder / f"{name}.yaml"


def read_config(path: Path) -> Config:
    """The configuration of a YAML file; unknown keys and kinds are refused by name."""
    try:
        raw: Any = yaml.safe_load(file_text(path))
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise InputError(f"{path}: cannot be read as YAML ({error})".replace("\n", " ")) from error
    name = raw.get("kind") if isinstance(raw, dict) else None
    if not isinstance(name, str) or name not in _KINDS:
        raise InputError(f"{path}: `kind` must be one of {', '.join(_KINDS)}")
    kind = _KINDS[name]
    known = {f.name: f.type for f in fields(kind)}
    if unknown := sorted(" ".join(str(key).split()) for key in set(raw) - set(known)):
        raise InputError(
            f"{path}: unknown keys {', '.join(unknown)}; known are {', '.join(sorted(known))}"
        )
    try:
        return kind(**{key: _typed(path, key, known[key], value) for key, value in raw.items()})
    # numbers beyond float64, and of so many digits that Python does not print them
    except (OverflowError, ValueError) as error:
        raise InputError(f"{path}: a number is out of all bounds ({error})") from error


def _typed(path: Path, key: str, kind: Any, value: Any) -> Any:
    """``value`` as the type of its field."""
    if get_origin(kind) is Literal:
        if value in get_args(kind):
            return value
        raise InputError(f"{path}: `{key}` must be one of {', '.join(get_args(kind))}")
    if kind in (Path, Path | None) and isinstance(value, str):
        return Path(value)
    if kind == Path | None and value is None:
        return None
    if kind == tuple[str, ...] and isinstance(value, list):
        if all(isinstance(each, str) for each in value):
            return tuple(value)
    elif kind is float and not isinstance(value, bool):
        try:
            return float(value)  # YAML 1.1 takes 1e-5, which has no point, for text
        except (TypeError, ValueError):
            pass
    elif type(value) is kind:
        return value
    raise InputError(
        f"{path}: `{key}` must be of type {getattr(kind, '__name__', kind)}, "
        f"got {reprlib.repr(value)}"
    )


def config_yaml(config: Config) -> str:
    """The resolved configuration as YAML, as :func:`read_config` reads it."""
    plain = {k: str(v) if isinstance(v, Path) else v for k, v in asdict(config).items()}
    return yaml.safe_dump(plain, sort_keys=False)
