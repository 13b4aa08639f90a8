"""Random people under lamps and skies of all kinds, rendered to measure landmark errors on."""

import math
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray
from torch import Tensor
from torch.nn.functional import normalize

from skylight.faces._fit import FaceFit
from skylight.imaging._colour import linear_to_srgb
from skylight.io._atomic import atomic_path
from skylight.models._ground import LambertianGround
from skylight.people._light import RenderOptions
from skylight.people._people import Person, person
from skylight.people._skin import SmoothHead
from skylight.skies._simulated import simulated_skies
from skylight.sphere._envmap import EnvironmentMap
from skylight.transport._cameras import Camera
from skylight.transport._matrix import SurfaceRays
from skylight.transport._rays import Raycaster
from skylight.transport._render import Specular, ggx, light_samples, rasterize

SIZE = 192
SEED = 777  # of people; no evaluation draws them from it
SKIES, FIRST_SKY_SEED = 40, 9_000_000  # beyond those that evaluations draw their skies from
SKY_ROWS = 8  # enough to make landmarks err as they do
HAIR_SHARE, LAMP_SHARE, SECOND_LAMP_SHARE = 0.8, 0.5, 0.3
FOCAL = 1.2, 3.2  # times the side
AMBIENT = 0.03, 0.1, 0.3  # irradiance of a lamp's surroundings, over the lamp's
GROUND = 0.14, 0.13, 0.12


@dataclass(frozen=True, kw_only=True)
class Pictured:
    """An 8-bit sRGB picture and the head in it."""

    encoded: UInt8[ndarray, "h w 3"]
    truth: FaceFit


def people(folder: Path, count: int) -> Iterator[Pictured]:
    """People 0 to ``count``; each is rendered once and kept in ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{number:05d}.npz" for number in range(count)]
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        missing = [number for number, path in enumerate(paths) if not path.is_file()]
        jobs = [pool.submit(_render_to, paths[number], number) for number in missing]
        for done, job in enumerate(jobs, start=1):
            job.result()
            if done % 50 == 0:
                print(f"{done} of {len(jobs)} people rendered", flush=True)
    for path in paths:
        with np.load(path) as stored:
            yield _pictured(dict(stored))


def _render_to(path: Path, number: int) -> None:
    torch.set_num_threads(1)
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **_arrays(render(number)))  # type: ignore[arg-type]


def _arrays(face: Pictured) -> dict[str, ndarray]:
    head = face.truth
    return {
        "encoded": face.encoded,
        "focal": np.asarray(head.camera.focal_px),
        "rotation": head.rotation,
        "translation": head.translation,
        "identity": head.identity,
        "expression": head.expression,
        "vertices": head.vertices.astype(np.float32),
    }


def _pictured(stored: dict[str, ndarray]) -> Pictured:
    middle = (SIZE / 2, SIZE / 2)
    camera = Camera(focal_px=float(stored["focal"]), width=SIZE, height=SIZE, center_px=middle)
    return Pictured(
        encoded=stored["encoded"],
        truth=FaceFit(
            camera=camera,
            rotation=stored["rotation"],
            translation=stored["translation"],
            identity=stored["identity"],
            expression=stored["expression"],
            vertices=stored["vertices"].astype(np.float64),
            landmark_error=0.0,
            converged=True,
        ),
    )


def render(number: int) -> Pictured:
    """All of it, from shape and skin to exposure and balance, follows from ``number``."""
    rng = np.random.default_rng((SEED, number))
    focal = float(rng.uniform(*FOCAL))
    hair = bool(rng.random() < HAIR_SHARE)
    who = person(number, focal, RenderOptions(size=SIZE, seed=SEED, hair=hair))
    mesh, faces, albedo = _surface(who)
    raycaster = Raycaster(mesh, faces)
    seen = rasterize(who.truth.camera, mesh, faces, raycaster)
    colour = (albedo[faces[seen.faces]] * seen.barycentric[..., None]).sum(1).float()
    directions, flux = _lamps(rng) if rng.random() < LAMP_SHARE else _sky(rng)
    rays = SurfaceRays.leaving(seen.origins, seen.normals, seen.geometric_normals, raycaster)
    cosine = torch.from_numpy(rays.visible_cosines(directions.numpy()))
    view = normalize(-seen.positions, dim=1).float()
    lobe = Specular(roughness=float(rng.uniform(0.35, 0.6)))
    n_v = (seen.normals.float() * view).sum(1).clamp(min=1e-3)
    specular = (cosine * ggx(cosine, n_v, directions @ view.T, lobe)).T @ flux
    radiance = colour * (cosine.T @ flux) / math.pi + float(rng.uniform(0.3, 1.6)) * specular
    white = torch.quantile(radiance.amax(1), float(rng.uniform(0.93, 1.0)))
    balance = torch.from_numpy(np.exp(rng.normal(0, 0.1, 3))).float()
    backdrop = torch.full((SIZE, SIZE, 3), float(rng.uniform(0.02, 0.6)))
    image = seen.image(radiance * 0.95 / white * balance, backdrop)
    image = image * torch.from_numpy(rng.normal(1, 0.01, image.shape)).float()
    encoded = (linear_to_srgb(image.clamp(0, 1)) * 255).round().to(torch.uint8)
    return Pictured(encoded=encoded.numpy(), truth=who.truth)


def _surface(who: Person) -> tuple[Tensor, Tensor, Tensor]:
    """(points, triangles, albedo) of head and hair."""
    points, faces, albedo = who.points, SmoothHead.load().faces, who.paint.albedo
    if who.cap is not None:
        faces = np.concatenate([faces, who.cap.faces + len(points)])
        points = np.concatenate([points, who.cap.points])
        hair = np.repeat(who.paint.hair[None], len(who.cap.points), axis=0)
        albedo = np.concatenate([albedo, hair])
    return tuple(torch.from_numpy(np.array(part)) for part in (points, faces, albedo))  # type: ignore[return-value]


def _lamps(
    rng: np.random.Generator,
) -> tuple[Float[Tensor, "d 3"], Float[Tensor, "d 3"]]:
    """One lamp or two in front of the face, of 1 to 9 degrees, and grey surroundings."""
    around = normalize(torch.from_numpy(rng.normal(size=(48, 3))), dim=1)
    dim = 4 * math.pi * float(rng.choice(AMBIENT)) / 4 / len(around)
    directions, flux = [around], [torch.full((len(around), 3), dim)]
    strengths = [1.0]
    if rng.random() < SECOND_LAMP_SHARE:
        strengths.append(float(rng.uniform(0.1, 0.6)))
    for strength in strengths:
        towards = np.array([0.0, 0.0, -1.0])
        while towards[2] <= -0.3 or towards[1] <= -0.5:
            towards = rng.normal(size=3)
            towards /= np.linalg.norm(towards)
        spread = rng.uniform(0.01, 0.15) * rng.normal(size=(12, 3))
        directions.append(normalize(torch.from_numpy(towards + spread), dim=1))
        flux.append(torch.full((12, 3), math.pi * strength / 12))
    return torch.cat(directions).float(), torch.cat(flux).float()


def _sky(rng: np.random.Generator) -> tuple[Float[Tensor, "d 3"], Float[Tensor, "d 3"]]:
    sky = _skies()[int(rng.integers(SKIES))].rotate_azimuth(float(rng.uniform(-math.pi, math.pi)))
    above = sky.upper()
    bounce = LambertianGround(above.layout[0])(above.flat[None], torch.tensor([GROUND]))[0]
    directions, flux = light_samples(above.with_ground(bounce).resize(SKY_ROWS), 2 * SKY_ROWS)
    return directions.float(), flux.float()


@cache
def _skies() -> list[EnvironmentMap]:
    return [sky.resize(SKY_ROWS) for _, sky in simulated_skies(SKIES, first_seed=FIRST_SKY_SEED)]
