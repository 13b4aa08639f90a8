"""Configurations of training runs, as they are read from YAML.

An option's type, default, bounds and meaning stand in one place, its field: files and what the
command line overrides are checked against it, and ``train.py --help`` shows it.
"""

import difflib
import math
import reprlib  # which stays short: YAML makes much of little
from collections.abc import Iterable
from dataclasses import Field, asdict, dataclass, field, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import yaml

from skylight.errors import InputError
from skylight.io._bounded import file_text
from skylight.models._bundle import LATENTS_MAX
from skylight.models._network_names import check_network_name
from skylight.models._sun_head import COORDINATES


def _bounded(default: int | float, *, least: int, most: int | float = math.inf) -> Any:
    """A field with a default and the values that it may have, both ends included."""
    return field(default=default, metadata={"least": least, "most": most})


class _Checked:
    """A configuration whose choices and bounded fields are checked when it is made."""

    def __post_init__(self) -> None:
        for each in fields(self):  # pyright: ignore[reportArgumentType]: of dataclasses alone
            value = getattr(self, each.name)
            if get_origin(each.type) is Literal and value not in get_args(each.type):
                raise InputError(f"`{each.name}` must be {allowed(each)}, got {value!r}")
            if "least" not in each.metadata:
                continue
            if not each.metadata["least"] <= value <= each.metadata["most"]:
                raise InputError(f"`{each.name}` must be {bounds(each)}, got {reprlib.repr(value)}")


def bounds(key: Field[Any]) -> str:
    """The values that a bounded field may have."""
    least, most = key.metadata["least"], key.metadata["most"]
    return f"at least {least}" if most == math.inf else f"from {least} to {most}"


@dataclass(frozen=True, kw_only=True)
class AutoencoderConfig(_Checked):
    """A run of the sky autoencoder."""

    kind: Literal["autoencoder"] = "autoencoder"
    data: Path = Path("runs/skies")
    """Folder of skies with an index, or the index."""
    out: Path = Path("runs/sky_autoencoder")
    """Folder of the run."""
    starts_from: Path | None = None
    """Checkpoint with the initial weights."""

    network: str = "splines"
    """Network: splines, the thesis' convolutions, or a class of yours: registered, or
    module:Class."""
    latents: int = 64
    """8 to 512 of splines, up to 1024 of a class of yours; convolutions have 64."""
    coding: Literal["log", "linear"] = "log"
    """Of radiance, a choice of convolutions; of your own network what that has."""
    sun: bool = True
    """Whether the sun has coordinates of its own; as coding."""

    noise_sigma: float = _bounded(0.01, least=0)
    """Standard deviation of the noise on the coded radiance that the encoder sees."""
    masked: float = _bounded(0.0, least=0, most=1)
    """Probability that a block of 8x8 pixels is hidden from the encoder."""
    sun_noise: float = _bounded(0.0, least=0)
    """Standard deviation of the noise on the sun's coordinates."""
    latent_noise: float = _bounded(0.0, least=0)
    """Standard deviation of the noise on the other latents."""

    energy_weight: float = _bounded(0.3, least=0)
    """Weight g of the loss, of errors times the pixel's energy."""
    squared_weight: float = _bounded(0.0, least=0)
    """Weight q of the loss, of squared errors."""
    scale_invariant: float = _bounded(0.0, least=0)
    """Weight s of the loss, which forgives a wrong exposure."""
    latent_penalty: float = _bounded(0.0, least=0)
    """Weight p of the loss, of the squared latents."""

    mirror: bool = True
    """Whether every other sky is mirrored."""
    surroundings: float = _bounded(0.0, least=0, most=1)
    """Probability that a scene stands before a sky."""
    tint: float = _bounded(0.0, least=0)
    """Standard deviation of the log gains of the colour channels."""
    white_balance: float = _bounded(0.0, least=0, most=1)
    """How far white balances go at most towards a grey mean."""
    copies: int = _bounded(1, least=1)
    """Variants of every sky, shown in turn, one an epoch."""

    epochs: int = _bounded(60, least=1)
    """Passes over the training skies; with more of them, a run that has ended goes on."""
    batch: int = _bounded(32, least=1)
    """Skies of a step, of all processes together."""
    optimiser: Literal["adamw", "sgd"] = "adamw"
    """AdamW, or stochastic gradient descent."""
    learning_rate: float = _bounded(0.001, least=0)
    """Its height, which the schedule goes down from."""
    schedule: Literal["cosine", "constant"] = "cosine"
    """Of the learning rate, after the warm-up."""
    warmup_steps: int = _bounded(200, least=0)
    """Over which the learning rate rises, at most a tenth of all steps."""
    momentum: float = _bounded(0.9, least=0)
    """Of sgd."""
    nesterov: bool = True
    """Of sgd."""
    weight_decay: float = _bounded(1e-5, least=0)
    """Of the optimiser."""
    gradient_clip: float = _bounded(1.0, least=0)
    """Largest norm of the gradients; 0 clips nothing."""
    patience: int = _bounded(12, least=1)
    """Epochs without a better validation loss after which the run ends."""
    checkpoint_steps: int = _bounded(100, least=1)
    """Steps between two states on disk, besides those after each epoch."""
    bfloat16: bool = True
    """Mixed precision where the device has it."""
    compile: bool = False
    """Whether torch compiles the loss."""
    threads: int = _bounded(0, least=0)
    """Of a process; 0 leaves their number to torch."""
    device: str = "auto"
    """auto (CUDA where it is), cpu or cuda."""
    seed: int = _bounded(0, least=0, most=9_999_999)  # steps' seeds are made of it, in 64 bits
    """Of the first weights, the order of the skies and the noise."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.optimiser == "sgd" and self.nesterov and self.momentum == 0:
            raise InputError("`nesterov` needs a `momentum` above 0; give one, or nesterov: false")
        if self.network == "splines" and (self.coding, self.sun) != ("log", True):
            raise InputError(
                "`coding` and `sun` are choices of network: convolutions, or of a class of yours "
                "that `network` names"
            )
        check_network_name(self.network)
        least, most = {"convolutions": (64, 64), "splines": (8, 512)}.get(
            self.network, (1 + COORDINATES * self.sun, LATENTS_MAX)
        )
        if not least <= self.latents <= most:
            raise InputError(
                f"`latents` of network: {self.network} must be from {least} to {most}, "
                f"got {self.latents}"
            )


@dataclass(frozen=True, kw_only=True)
class PriorConfig(_Checked):
    """A fit of the mixtures over latents and over Sun+Sky parameters."""

    kind: Literal["prior"] = "prior"
    data: Path = Path("runs/skies")
    """Folder of skies with an index, or the index."""
    checkpoint: Path = Path("runs/sky_autoencoder/model.safetensors")
    """The network whose latents have the prior."""
    network: str = ""
    """Its class, if that is yours: registered, or module:Class."""
    out: Path = Path("runs/sky_prior")
    """Folder for the light model."""
    most_components: int = _bounded(8, least=1)
    """Most Gaussians of a mixture."""
    bank: int = _bounded(480, least=24)
    """Training skies that estimates may start from."""
    seed: int = 0
    """Of the mixtures' first means, and of which skies of the bank are taken."""


@dataclass(frozen=True, kw_only=True)
class DictionaryConfig(_Checked):
    """Learning filters for sparse codes from a folder of light probes."""

    kind: Literal["dictionary"] = "dictionary"
    data: Path = Path("runs/probes")
    """Folder of .exr or .hdr light probes."""
    out: Path = Path("runs/dictionary")
    """Folder for the dictionary."""
    method: Literal["kmeans", "gradient"] = "gradient"
    """Means of patches, or those improved by Adam."""
    filters: int = _bounded(100, least=1)
    """Learned ones."""
    category: str = ""
    """How the categories in index.csv of the maps to take begin; empty takes all."""
    maps: tuple[str, ...] = ()
    """Files to take; none takes all."""
    degree: int = _bounded(40, least=3)
    """Of the filters' spherical harmonics."""
    seed: int = _bounded(0, least=0, most=2**32 - 1)  # NumPy's
    """Of the first means."""

    rows: int = 32
    """Of the maps, for the method gradient, as what follows is."""
    activations: int = _bounded(36, least=1)
    """Filters that code a map."""
    epochs: int = _bounded(1, least=1)
    """Passes over the maps; with more of them, a run that has ended goes on."""
    radius_deg: float = 30.0
    """Of a filter."""
    signed: bool = False
    """Whether filters may be negative."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.degree + 1) ** 2 <= 2 * self.rows**2 or self.rows >= 64:
            raise InputError(
                f"`rows` must be below 64, and 2 rows^2 at least (degree + 1)^2 = "
                f"{(self.degree + 1) ** 2}, got {self.rows}"
            )
        if not 0 < self.radius_deg <= 90:
            raise InputError(f"`radius_deg` must be above 0, at most 90, got {self.radius_deg}")


@dataclass(frozen=True, kw_only=True)
class PlacesConfig(_Checked):
    """The light model of the whole sphere, from simulated places."""

    kind: Literal["places"] = "places"
    data: Path = Path("runs/places")
    """Folder that ``skylight places simulate`` wrote."""
    out: Path = Path("runs/sphere")
    """Folder for the model."""
    latents: int = _bounded(80, least=2, most=256)
    """Numbers that code the smooth light of a place."""
    across: int = _bounded(13, least=5, most=64)
    """Control points across the disk above the horizon, and across that below."""
    places_a_component: int = _bounded(600, least=100)
    """Training places for each Gaussian of the prior."""
    seed: int = _bounded(0, least=0, most=2**32 - 1)  # NumPy's
    """Of white balances, and of the Gaussians' first means."""


Config = AutoencoderConfig | PriorConfig | DictionaryConfig | PlacesConfig
_KINDS: dict[str, type[Config]] = {
    "autoencoder": AutoencoderConfig,
    "prior": PriorConfig,
    "dictionary": DictionaryConfig,
    "places": PlacesConfig,
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
    shipped = shipped_configs()
    if name not in shipped:
        raise InputError(
            f"no configuration {name!r}: choose one of {', '.join(shipped)}, or give a .yaml file"
        )
    return shipped[name]


def shipped_configs() -> dict[str, Path]:
    """The configurations that come with skylight, by name."""
    packed = Path(str(files("skylight.training") / "configs"))  # in a wheel; see setup.py
    folder = packed if packed.is_dir() else Path(__file__).parents[2] / "configs"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


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
    known = keys_of(kind, str(path), raw)
    try:
        return kind(**{key: typed(str(path), known[key], each) for key, each in raw.items()})
    # numbers beyond float64, and of so many digits that Python does not print them
    except (OverflowError, ValueError) as error:
        raise InputError(f"{path}: a number is out of all bounds ({error})") from error


def keys_of(kind: type[Config], where: str, names: Iterable[object]) -> dict[str, Field[Any]]:
    """The fields of a kind by name, among which are all ``names``; ``where`` they are given."""
    known = {each.name: each for each in fields(kind)}
    if unknown := sorted(" ".join(str(name).split()) for name in set(names) - set(known)):
        near = [near for name in unknown for near in difflib.get_close_matches(name, known, 1)]
        meant = f"did you mean {', '.join(near)}? " if near else ""
        raise InputError(
            f"{where}: unknown keys {', '.join(unknown)}; {meant}known are "
            f"{', '.join(sorted(known))}"
        )
    return known


def typed(where: str, key: Field[Any], value: Any) -> Any:
    """``value`` as the type of its field; ``where`` it is given."""
    kind: Any = key.type
    if get_origin(kind) is Literal:
        if value in get_args(kind):
            return value
    elif kind in (Path, Path | None) and isinstance(value, str):
        return Path(value)
    elif kind == Path | None and value is None:
        return None
    elif kind == tuple[str, ...] and isinstance(value, list):
        if all(isinstance(each, str) for each in value):
            return tuple(value)
    elif kind is float and not isinstance(value, bool):
        try:
            return float(value)  # YAML 1.1 takes 1e-5, which has no point, for text
        except (TypeError, ValueError):
            pass
    elif type(value) is kind:
        return value
    raise InputError(f"{where}: `{key.name}` must be {allowed(key)}, got {reprlib.repr(value)}")


def allowed(key: Field[Any]) -> str:
    """The values that a field may have, in words."""
    kind: Any = key.type
    if get_origin(kind) is Literal:
        return f"one of {', '.join(get_args(kind))}"
    words = {bool: "true or false", Path: "a path", Path | None: "a path or none", str: "a text"}
    words |= {int: "a whole number", float: "a number", tuple[str, ...]: "a list of texts"}
    return f"{words[kind]} {bounds(key)}" if "least" in key.metadata else words[kind]


def config_yaml(config: Config) -> str:
    """The resolved configuration as YAML, as :func:`read_config` reads it."""
    plain = {k: str(v) if isinstance(v, Path) else v for k, v in asdict(config).items()}
    return yaml.safe_dump(plain, sort_keys=False)
