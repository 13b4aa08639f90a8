"""The light model of places (:mod:`skylight.models._sphere`) from a folder of simulated ones.

Maps are seen as log radiance on 32 rows, of a mean luminance of 1, as a camera balances them,
turned so that their strongest light is straight ahead. Their principal components over the sphere,
those of their mirror images among them, are the model, its latents those of least squares. The
prior is fitted to each kind of place by itself.
"""

import csv
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.io._bounded import file_text, write_json
from skylight.io._files import INDEX_NAME, read_environment_map
from skylight.models._lobes import (
    LAMP_CHROMA,
    LAMP_ENERGY,
    LAMP_ENERGY_SPREAD,
    LAMP_WIDTH_RAD,
    LAMP_WIDTH_SPREAD,
    LONGEST,
    MOST_ENERGY,
)
from skylight.models._manifest import PLACES
from skylight.models._prior import GaussianMixture, precision_factors_of
from skylight.models._sphere import MOST_LAMPS, Places
from skylight.places._simulated import LIGHTS_NAME, read_lights
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid, direction_from_angles
from skylight.sphere._lobes import DiskSplines
from skylight.training._config import PlacesConfig
from skylight.work._progress import StageProgress, silent
from skylight.work._resumable import results_folder

SCORES = "scores.json"
ROWS = 32
FLOOR = 3e-3  # radiance, of a mean luminance of 1: what is darker is alike
NORMALS = 64
# What share of a place's own colour a camera's white balance takes away (log): little is left of
# lamplight, and some pictures are balanced past grey
BALANCED = 0.6, 1.05
STRONG = 0.024  # of all light: what a map is turned to
LEAST_LAMP = 0.02  # energy of a lamp beside the smooth light's that counts as one
RIDGE = 1e-3  # of a mean control point's weight, in least squares
# Of the mixture's covariances: so many samples' worth of the kind's own diagonal
SHRINKAGE = 100


@dataclass(frozen=True, kw_only=True)
class PlaceLight:
    """A distinct light of a map, as :class:`skylight.places._simulated.LightRecord`."""

    azimuth_rad: float
    zenith_rad: float
    energy: tuple[float, float, float]
    radius_rad: float
    in_map: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaceMaps:
    """Maps for training: ``log`` radiance (n, 2048, 3), turned by ``azimuth_rad`` already."""

    log: Float[Tensor, "n d 3"]
    azimuth_rad: Float[Tensor, " n"]
    kind: list[str]
    lights: list[list[PlaceLight]]
    is_test: list[bool]

    def with_mirrored(self) -> Float[Tensor, "_ d 3"]:
        """Their log radiance, and that of the same left for right."""
        log = self.log.float()
        return torch.cat([log, log.unflatten(1, (ROWS, -1)).flip(2).flatten(1, 2)])

    def rows(self, which: Sequence[int]) -> "PlaceMaps":
        return PlaceMaps(
            log=self.log[list(which)],
            azimuth_rad=self.azimuth_rad[list(which)],
            kind=[self.kind[k] for k in which],
            lights=[self.lights[k] for k in which],
            is_test=[self.is_test[k] for k in which],
        )


def read_maps(folder: Path, workers: int = 2, seed: int = 0) -> PlaceMaps:
    """All maps of a folder that ``skylight places simulate`` wrote, as cameras balance them."""
    index: list[dict[str, str]] = []
    if (folder / INDEX_NAME).is_file():
        index = list(csv.DictReader(StringIO(file_text(folder / INDEX_NAME), newline="")))
    if not index:
        raise InputError(f"{folder}: no map is there; simulate some with skylight places simulate")
    lights = {
        file: [
            PlaceLight(
                azimuth_rad=math.radians(light.azimuth_deg),
                zenith_rad=math.radians(light.zenith_deg),
                energy=(light.red, light.green, light.blue),
                radius_rad=math.radians(light.radius_deg),
                in_map=bool(light.in_map),
            )
            for light in there
        ]
        for file, there in read_lights(folder / LIGHTS_NAME).items()
    }
    named = [lights.get(row["file"], []) for row in index]
    balances = np.random.default_rng(seed).uniform(*BALANCED, len(index))

    def one(k: int) -> tuple[Tensor, float, list[PlaceLight]]:
        radiance = read_environment_map(folder / index[k]["file"]).resize(ROWS).radiance
        return _centred(*_balanced(radiance, named[k], float(balances[k])))

    with ThreadPoolExecutor(workers) as pool:
        found = list(pool.map(one, range(len(index))))
    return PlaceMaps(
        log=torch.stack([log for log, _, _ in found]),
        azimuth_rad=torch.tensor([azimuth for _, azimuth, _ in found]),
        kind=[row["kind"] for row in index],
        lights=[lights for _, _, lights in found],
        is_test=[row["split"] != "train" for row in index],
    )


def _balanced(
    radiance: Float[Tensor, "h w 3"], lights: Sequence[PlaceLight], share: float
) -> tuple[Float[Tensor, "h w 3"], list[PlaceLight]]:
    """A map and its lights without a ``share`` of the colour of all their light, in logs."""
    grid = DirectionGrid.latlong(radiance.shape[0])
    total = grid.solid_angles.float() @ radiance.reshape(-1, 3)
    total = total + sum(torch.tensor(each.energy) for each in lights if not each.in_map)
    gains = (luminance(total) / total.clamp(min=1e-12)) ** share

    def balanced(light: PlaceLight) -> PlaceLight:
        red, green, blue = (torch.tensor(light.energy) * gains).tolist()
        return replace(light, energy=(red, green, blue))

    return radiance * gains, [balanced(each) for each in lights]


def _centred(
    radiance: Float[Tensor, "h w 3"], lights: Sequence[PlaceLight]
) -> tuple[Float[Tensor, "d 3"], float, list[PlaceLight]]:
    """A map's (log radiance with the strongest light straight ahead, by how much it was turned,
    lights), of a mean luminance of 1."""
    height, width, _ = radiance.shape
    solid = DirectionGrid.latlong(height).solid_angles.float()
    share = (solid / (4 * math.pi)).reshape(height, width)
    level = luminance(radiance)
    mean = float((level * share).sum().clamp(min=1e-12))
    radiance = radiance / mean
    lights = [replace(each, energy=_over(each.energy, mean)) for each in lights]
    strongest = max(lights, key=_luminous, default=None)
    if strongest is not None and _luminous(strongest) > STRONG * 4 * math.pi:
        azimuth = strongest.azimuth_rad
    else:
        column = ((level + FLOOR * level.mean()).log() * share).sum(0)
        at = 2 * math.pi * ((torch.arange(width) + 0.5) / width - 0.5)
        azimuth = math.atan2(float(column @ at.sin()), float(column @ at.cos()))
    columns = round(azimuth / (2 * math.pi) * width)
    log = torch.log(radiance + FLOOR).roll(-columns, 1)
    return log.reshape(-1, 3).half(), columns * 2 * math.pi / width, lights


def _over(energy: tuple[float, float, float], mean: float) -> tuple[float, float, float]:
    red, green, blue = (each / mean for each in energy)
    return red, green, blue


def _luminous(light: PlaceLight) -> float:
    return float(luminance(torch.tensor(light.energy)))


class Decoder:
    """Control points (of both disks) to log radiance on 32 rows, and back by least squares."""

    def __init__(self, across: int) -> None:
        splines = DiskSplines(across, DirectionGrid.sky(ROWS // 2))
        grid = DirectionGrid.latlong(ROWS)
        half = splines.matrix()
        flipped = half.unflatten(0, (ROWS // 2, -1)).flip(0).flatten(0, 1)
        matrix = torch.block_diag(half, flipped)
        weights = grid.solid_angles.double() / (4 * math.pi)
        gram = matrix.T @ (weights[:, None] * matrix)
        gram += RIDGE * gram.diagonal().mean() * torch.eye(len(gram)).double()
        self.across = across
        self.matrix = matrix.float()
        self.inverse = torch.linalg.solve(gram, matrix.T * weights).float()
        self.weights = weights.float()
        self.directions = grid.directions.float()
        self.solid_angles = grid.solid_angles.float()
        normals = DirectionGrid.hammersley(NORMALS).directions.float()
        self.irradiance = (normals @ self.directions.T).clamp(min=0) * self.solid_angles


@dataclass(frozen=True, kw_only=True, eq=False)
class Linear:
    """log A = M (b + F z). Latents are those of least squares."""

    control: Float[Tensor, "n 3"]
    basis: Float[Tensor, "z n 3"]

    def latents(self, decoder: Decoder, log: Float[Tensor, "b d 3"]) -> Float[Tensor, "b z"]:
        fields = (decoder.matrix @ self.basis).flatten(1)
        root = decoder.weights.sqrt().repeat_interleave(3)
        weighted = fields * root
        left = (log - decoder.matrix @ self.control).flatten(1) * root
        gram = weighted @ weighted.T
        gram = gram + 1e-5 * gram.diagonal().mean() * torch.eye(len(gram), device=gram.device)
        return torch.linalg.solve(gram, weighted @ left.T).T

    def log(self, decoder: Decoder, z: Float[Tensor, "b z"]) -> Float[Tensor, "b d 3"]:
        control = self.control + torch.einsum("bz,znc->bnc", z, self.basis)
        return decoder.matrix @ control


def principal(decoder: Decoder, log: Float[Tensor, "n d 3"], latents: int, seed: int = 0) -> Linear:
    """Of principal components, weighted by solid angle."""
    mean = log.mean(0)
    root = decoder.weights.sqrt()[:, None]
    centred = ((log - mean) * root).flatten(1)
    with torch.random.fork_rng([]):  # it begins with random directions
        torch.manual_seed(seed)
        axes = torch.svd_lowrank(centred, q=latents + 10, niter=6)[2][:, :latents]
    fields = axes.T.unflatten(1, (-1, 3)) / root
    return Linear(control=decoder.inverse @ mean, basis=decoder.inverse @ fields)


def whitened(model: Linear, z: Float[Tensor, "n z"]) -> tuple[Linear, Float[Tensor, "n z"]]:
    """The same light with latents of mean 0 and covariance 1 over ``z``."""
    mean, root = z.mean(0), torch.linalg.cholesky(torch.cov(z.double().T)).to(z)
    control = model.control + torch.einsum("z,znc->nc", mean, model.basis)
    basis = torch.einsum("zy,znc->ync", root, model.basis)
    white = torch.linalg.solve_triangular(root, (z - mean).T, upper=False).T
    return Linear(control=control, basis=basis), white


def scores(
    decoder: Decoder, model: Linear, log: Float[Tensor, "n d 3"]
) -> dict[str, Float[Tensor, " n"]]:
    """Errors of maps that are coded: log radiance (rms), irradiance (rms over rms)."""
    found: dict[str, list[Tensor]] = {"log_rmse": [], "irradiance": []}
    for some in log.float().split(512):
        made = model.log(decoder, model.latents(decoder, some))
        found["log_rmse"].append(((made - some).square().mean(2) @ decoder.weights).sqrt())
        lit, wanted = decoder.irradiance @ made.exp(), decoder.irradiance @ some.exp()
        scale = (lit * wanted).sum((1, 2)) / lit.square().sum((1, 2))
        off = (scale[:, None, None] * lit - wanted).square().mean((1, 2)).sqrt()
        found["irradiance"].append(off / wanted.square().mean((1, 2)).sqrt())
    return {name: torch.cat(each) for name, each in found.items()}


def lamps_of(
    decoder: Decoder, model: Linear, maps: PlaceMaps, z: Float[Tensor, "n z"]
) -> list[Float[Tensor, "k 7"]]:
    """What lamps each map has beside its smooth light: as parameters of ``SphereLight``.

    Of a light that the map shows, what the model lacks within its disc; of others all.
    """
    found: list[Float[Tensor, "k 7"]] = []
    for k, lights in enumerate(maps.lights):
        smooth = model.log(decoder, z[k : k + 1])[0].exp()
        mean = float(luminance(smooth) @ decoder.weights)
        lamps = []
        for light in lights:
            azimuth = light.azimuth_rad - float(maps.azimuth_rad[k])
            towards = direction_from_angles(
                torch.tensor(azimuth), torch.tensor(light.zenith_rad)
            ).to(smooth)
            energy = torch.tensor(light.energy).to(smooth)
            if light.in_map:
                radius = max(light.radius_rad, math.pi / ROWS)
                inside = (decoder.directions @ towards) > math.cos(radius)
                energy = energy - (smooth * (decoder.solid_angles * inside)[:, None]).sum(0)
            strength = float(luminance(energy)) / (4 * math.pi * mean)
            if strength > LEAST_LAMP and float(energy.min()) > 0:
                lamps.append((strength, _lamp(towards, strength, energy, light.radius_rad)))
        lamps.sort(key=lambda lamp: -lamp[0])
        each = [lamp for _, lamp in lamps[:MOST_LAMPS]]
        found.append(torch.stack(each) if each else torch.zeros(0, 7))
    return found


def _lamp(
    towards: Float[Tensor, "3"], strength: float, energy: Float[Tensor, "3"], radius_rad: float
) -> Float[Tensor, "7"]:
    """Its seven parameters (:class:`~skylight.models._lobes.LampedLight`)."""
    below = 1 / min(strength, 0.9 * MOST_ENERGY) - 1 / MOST_ENERGY
    red, green, blue = energy.tolist()
    numbers = [
        -math.log(LAMP_ENERGY * below) / LAMP_ENERGY_SPREAD,
        # an even disc has a variance of r^2 / 4 per axis
        math.log(max(radius_rad / 2, math.radians(1.0)) / LAMP_WIDTH_RAD) / LAMP_WIDTH_SPREAD,
        math.log(red / green) / LAMP_CHROMA,
        math.log(blue / green) / LAMP_CHROMA,
    ]
    limited = [min(max(each, -LONGEST), LONGEST) for each in numbers]
    return torch.tensor([*towards.tolist(), *limited])


def train_places(config: PlacesConfig, progress: StageProgress = silent) -> Path:
    """Learn the model of a folder of places; returns ``config.out``, with model and scores."""
    maps = read_maps(config.data, seed=config.seed)
    progress("reading", 1.0)
    train = maps.rows([k for k, test in enumerate(maps.is_test) if not test])
    held = maps.rows([k for k, test in enumerate(maps.is_test) if test])
    kinds = tuple(dict.fromkeys(sorted(maps.kind)))
    decoder = Decoder(config.across)
    if len(train.kind) < 2 * config.latents:
        raise InputError(
            f"{config.data}: {len(train.kind)} training places are too few for {config.latents} "
            f"latents; simulate {4 * config.latents} or more"
        )
    model = principal(decoder, train.with_mirrored(), config.latents, config.seed)
    progress("components", 1.0)
    places = places_of(decoder, model, train, kinds, config.places_a_component, config.seed)
    progress("prior", 1.0)
    with results_folder(config.out) as folder:
        places.save(folder / PLACES, {"places": str(len(train.kind))})
        write_json(folder / SCORES, {"places": len(train.kind), **_summary(decoder, model, held)})
    return config.out


def _summary(decoder: Decoder, model: Linear, held: PlaceMaps) -> Mapping[str, object]:
    """Errors of places that the model has not seen; none where there are none."""
    if not held.kind:
        return {}
    found = scores(decoder, model, held.log)
    return {"held out": len(held.kind)} | {
        name: {"median": float(each.median()), "90 %": float(each.quantile(0.9))}
        for name, each in found.items()
    }


def places_of(
    decoder: Decoder,
    model: Linear,
    maps: PlaceMaps,
    kinds: Sequence[str],
    places_a_component: int,
    seed: int = 0,
) -> Places:
    """The model with its prior, of training maps."""
    z = model.latents(decoder, maps.with_mirrored())
    model, white = whitened(model, z)
    count = len(maps.kind)
    lamps = lamps_of(decoder, model, maps, white[:count])
    of_kind = np.array(maps.kind)
    parts, kind_of, told = [], [], []
    for number, kind in enumerate(kinds):
        mine = np.flatnonzero(of_kind == kind)
        both = torch.from_numpy(np.concatenate([mine, mine + count]))
        mixture = shrunk(white[both], max(1, round(len(mine) / places_a_component)), seed)
        parts.append((mixture, len(mine) / count))
        kind_of += [number] * len(mixture.weights)
        told.append(_lamps_told([lamps[k] for k in mine.tolist()]))
    tensors = {
        "control": model.control.T,
        "basis": model.basis.mT,
        "log_weights": torch.cat([mix.weights.log() + math.log(share) for mix, share in parts]),
        "means": torch.cat([mixture.means for mixture, _ in parts]),
        "precision_factors": torch.cat([mixture.precision_factors for mixture, _ in parts]),
        **{name: torch.stack([each[name] for each in told]) for name in told[0]},
    }
    return Places(
        kinds=tuple(kinds),
        across=decoder.across,
        kind=torch.tensor(kind_of),
        **{name: each.float().contiguous() for name, each in tensors.items()},
    )


def shrunk(samples: Float[Tensor, "n z"], components: int, seed: int) -> GaussianMixture:
    """A mixture whose covariances lean to the kind's own diagonal, where samples are few."""
    fitted = GaussianMixture.fit(samples, components, seed=seed, covariance_floor=1e-2)
    diagonal = torch.diag_embed(samples.double().var(0))
    count = (len(samples) * fitted.weights)[:, None, None]
    covariance = (count * fitted.covariances + SHRINKAGE * diagonal) / (count + SHRINKAGE)
    return GaussianMixture(fitted.weights, fitted.means, precision_factors_of(covariance))


def _lamps_told(lamps: Sequence[Float[Tensor, "k 7"]]) -> dict[str, Tensor]:
    """What the lamps of one kind's places are like; a tenth of a place has each number of them."""
    counts = torch.bincount(torch.tensor([len(each) for each in lamps]), minlength=4).double() + 0.1
    every = torch.cat([*lamps]).double()
    numbers = every[:, 3:]
    usual = torch.zeros(4).double() if len(every) == 0 else numbers.mean(0)
    offset = numbers - usual
    covariance = (offset.T @ offset + 20 * torch.eye(4).double()) / (len(every) + 20)
    up, azimuth = every[:, 1], torch.atan2(every[:, 0], -every[:, 2])
    near = (azimuth.abs() < math.radians(30)).double().sum()
    return {
        "log_counts": (counts / counts.sum()).log(),
        "lamp_means": usual,
        "lamp_factors": precision_factors_of(covariance),
        "lamp_up": torch.tensor(_height(float((up.sum()) / (len(up) + 5)))),
        # what a uniform azimuth puts there is a sixth
        "lamp_ahead": ((near + 1) / (len(every) + 2) * 1.2 - 0.2).clamp(0.05, 0.95),
    }


def _height(mean: float) -> float:
    """h of the density ``e^(h y)`` over -1 to 1 of that mean: ``coth h - 1 / h``."""
    h = torch.linspace(-8, 8, 1600, dtype=torch.float64)
    means = 1 / h.tanh() - 1 / h
    found = float(h[(means - mean).abs().argmin()])
    return found if abs(found) > 0.05 else math.copysign(0.05, found or 1.0)
