"""Rendering by Mitsuba 3 (extra ``render``): solids, lamps, photographs of them.

Mitsuba's variant decides how many rays are traced at once: a wavefront where it compiles kernels,
else one by one.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from skylight.errors import not_installed
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import convert_latlong
from skylight.transport._cameras import Camera

DEPTH = 6  # path vertices: with an albedo of 0.8 what is left out is below 1 % of concave corners


@dataclass(frozen=True, kw_only=True)
class Solid:
    """A Lambertian mesh of one albedo, or painted: ``paint`` is a picture of albedos over ``uv``.

    The picture's row 0 is at v = 1.
    """

    vertices: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, "t 3"]
    albedo: float = 0.8
    paint: Float[np.ndarray, "h w 3"] | None = None
    uv: Float[np.ndarray, "n 2"] | None = None


@dataclass(frozen=True, kw_only=True)
class SphereLamp:
    """A sphere that emits ``radiance`` evenly, in the units of the solids."""

    centre: Float[np.ndarray, "3"]
    radius: float
    radiance: float


class IndependentScene:
    """Solids under a distant light or a lamp; ``radiance`` renders linear light."""

    def __init__(self, solids: Sequence[Solid], light: EnvironmentMap | SphereLamp) -> None:
        mi = mitsuba_variant()
        content: dict[str, object] = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": DEPTH},
            "light": _lamp(light) if isinstance(light, SphereLamp) else _sky(mi, light),
        }
        for number, solid in enumerate(solids):
            content[f"solid{number}"] = _mesh(mi, solid)
        self._scene = mi.load_dict(content)

    def radiance(
        self,
        camera: Camera,
        rotation: Float[np.ndarray, "3 3"],
        translation: Float[np.ndarray, "3"],
        *,
        samples: int,
        seed: int = 0,
    ) -> Float[np.ndarray, "h w 3"]:
        """For a camera to which world points stand at ``rotation @ x + translation``.

        ``rotation`` leads into skylight's camera frame: -Z ahead, +Y up. Distances must be above
        1e-3 and below 1e5 units.
        """
        mi = mitsuba_variant()
        film = {"pixel_format": "rgb"}
        sensor = mi.load_dict(pinhole(camera, rotation, translation, samples=samples, film=film))
        picture = mi.render(self._scene, sensor=sensor, spp=samples, seed=mi.UInt32(seed))
        return np.array(picture, dtype=np.float32)


def pinhole(
    camera: Camera,
    rotation: Float[np.ndarray, "3 3"],
    translation: Float[np.ndarray, "3"],
    *,
    samples: int,
    film: Mapping[str, object],
    sampler: str = "independent",
) -> dict[str, object]:
    """Mitsuba's description of a camera, with a film of its size and what ``film`` adds."""
    mi = mitsuba_variant()
    return {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(camera.width / (2 * camera.focal_px)))),
        "fov_axis": "x",
        "near_clip": 1e-3,
        "far_clip": 1e5,
        "principal_point_offset_x": 0.5 - camera.center_px[0] / camera.width,
        "principal_point_offset_y": 0.5 - camera.center_px[1] / camera.height,
        "to_world": mi.ScalarTransform4f(_to_world(rotation, translation).tolist()),
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "rfilter": {"type": "box"},
            **film,
        },
        "sampler": {"type": sampler, "sample_count": samples},
    }


def _to_world(
    rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """Mitsuba's cameras look along +Z with +Y up, so +X is to the left."""
    out = np.eye(4)
    right, up, back = rotation
    out[:3, :3] = np.stack([-right, up, -back], 1)
    out[:3, 3] = -rotation.T @ translation
    return out


def _sky(mi, environment: EnvironmentMap) -> dict[str, object]:
    sky = convert_latlong(environment.radiance, "skylight", "mitsuba").float().contiguous()
    return {"type": "envmap", "bitmap": mi.Bitmap(sky.numpy())}


def _lamp(lamp: SphereLamp) -> dict[str, object]:
    return {
        "type": "sphere",
        "center": lamp.centre.tolist(),
        "radius": lamp.radius,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": lamp.radiance}},
    }


def _mesh(mi, solid: Solid):
    painted = solid.paint is not None and solid.uv is not None
    colour: dict[str, object] = {"type": "rgb", "value": solid.albedo}
    if painted:
        colour = {
            "type": "bitmap",
            "bitmap": mi.Bitmap(np.ascontiguousarray(solid.paint, dtype=np.float32)),
            "raw": True,
            "filter_type": "bilinear",
            "wrap_mode": "clamp",
        }
    both = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": colour}}
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(both)
    properties["face_normals"] = True
    mesh = mi.Mesh(
        "solid",
        vertex_count=len(solid.vertices),
        face_count=len(solid.triangles),
        has_vertex_normals=False,
        has_vertex_texcoords=painted,
        props=properties,
    )
    content = mi.traverse(mesh)
    content["vertex_positions"] = solid.vertices.astype(np.float32).ravel()
    content["faces"] = solid.triangles.astype(np.uint32).ravel()
    if painted:
        assert solid.uv is not None
        # Mitsuba's v runs downwards
        content["vertex_texcoords"] = (solid.uv * [1, -1] + [0, 1]).astype(np.float32).ravel()
    content.update()
    return mesh


@cache
def mitsuba_variant():
    """The fastest variant that works here: LLVM where a recent one is found, else scalar."""
    try:
        import mitsuba as mi
    except ImportError as error:
        raise not_installed("mitsuba", "rendering by another program") from error
    if os.environ.get("DRJIT_LIBLLVM_PATH") and "llvm_ad_rgb" in mi.variants():
        mi.set_variant("llvm_ad_rgb")
    else:
        mi.set_variant("scalar_rgb")
    return mi


def as_photo(
    linear: Float[np.ndarray, "h w 3"], *, exposure: float, noise: float, seed: int
) -> UInt8[np.ndarray, "h w 3"]:
    """sRGB codes of a camera: exposed, encoded, with Gaussian noise of ``noise`` codes, clipped."""
    from skylight.imaging._colour import linear_to_srgb

    encoded = linear_to_srgb(torch.from_numpy(linear * exposure).clamp(0, 1)).numpy() * 255
    noisy = encoded + noise * np.random.default_rng(seed).standard_normal(encoded.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def radiance_along(
    scene,
    integrator,
    origins: Float[ndarray, "n s 3"],
    directions: Float[ndarray, "n s 3"],
    seed: int,
) -> Float[ndarray, "n s 3"]:
    """What ``integrator`` finds that comes along each ray, one light path each.

    The s paths of one of the n places are spread evenly (a multi-jittered s, a square number).
    """
    mi = mitsuba_variant()
    import drjit as dr

    many = origins.shape[1]
    sampler = mi.load_dict({"type": "multijitter", "sample_count": many})
    starts, ways = (x.astype(np.float32).reshape(-1, 3) for x in (origins, directions))
    if not dr.is_jit_v(mi.Float):
        found = []
        for n, (start, way) in enumerate(zip(starts.tolist(), ways.tolist(), strict=True)):
            if n % many == 0:
                sampler.seed(seed + n)
            ray = mi.RayDifferential3f(mi.Point3f(start), mi.Vector3f(way))
            found.append(integrator.sample(scene, sampler, ray)[0])
            sampler.advance()
        return np.array(found, dtype=np.float64).reshape(origins.shape)
    sampler.set_samples_per_wavefront(many)
    sampler.seed(seed, len(starts))
    rays = mi.RayDifferential3f(mi.Point3f(starts.T.copy()), mi.Vector3f(ways.T.copy()))
    found, _, _ = integrator.sample(scene, sampler, rays)
    return np.array(found, dtype=np.float64).T.reshape(origins.shape)


def emitted(emitter, directions: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
    """The radiance that an emitter of the whole sphere has in each direction."""
    mi = mitsuba_variant()
    import drjit as dr

    from_there = -directions.astype(np.float32)
    point = dr.zeros(mi.SurfaceInteraction3f)
    if not dr.is_jit_v(mi.Float):
        found = []
        for way in from_there.tolist():
            point.wi = way
            found.append(emitter.eval(point))
        return np.array(found, dtype=np.float64).reshape(-1, 3)
    point.wi = mi.Vector3f(from_there.T.copy())
    return np.array(emitter.eval(point), dtype=np.float64).T
