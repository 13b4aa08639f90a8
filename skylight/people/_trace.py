"""Diffuse and specular radiance of a person, by Mitsuba."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from skylight.faces._model import Region
from skylight.people._independent_render import mitsuba_variant, pinhole, radiance_along
from skylight.people._light import DistantLight, camera_frame
from skylight.people._people import Person
from skylight.people._skin import SmoothHead, normals_of
from skylight.people._subsurface import SkinPatches
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import convert_latlong

INDEX = 1.4  # of refraction, of skin and (nearly) of the cornea
EYE_ROUGHNESS = 0.2
HAIR_ROUGHNESS = 0.55
_DEPTH = 5  # path vertices of diffuse light; what is left out lies below 1 % in deep corners
_FINER = 8  # columns of the light's map given to Mitsuba, per column of ours
_MARGIN = 3  # px round the head
_PATCH_SAMPLES = 4  # light paths of a pixel to one of a patch of skin that none shows
_LIFT_M = 2e-5  # where rays to a patch begin, above it


@dataclass(frozen=True, kw_only=True)
class Layers:
    """Pictures in the light's units: ``diffuse`` light from inside, ``specular`` from the surface.

    Where a pixel is covered in part, all are scaled by ``cover``. ``albedo`` is that of what the
    camera sees, so diffuse / albedo is irradiance / pi, which ``entering`` is at patches of skin.
    """

    diffuse: Float[ndarray, "h w 3"]
    specular: Float[ndarray, "h w 3"]
    albedo: Float[ndarray, "h w 3"]
    cover: Float[ndarray, "h w"]
    entering: Float[ndarray, "k 3"]


def trace(
    person: Person,
    light: DistantLight,
    patches: SkinPatches,
    *,
    samples: int,
    seed: int,
    world_from_camera: Float[ndarray, "3 3"] | None = None,
) -> Layers:
    """Two renders of the head under the light, which a turned camera sees turned.

    The inside is Lambertian, path traced with the light that skin throws onto skin, in the picture
    and, with a quarter of the paths, at places of each patch that no pixel shows. The surface is
    a GGX lobe with Fresnel's reflectance (Mitsuba's ``principled``, black), direct light only: it
    does not show the face mirrored in itself.
    """
    mi = mitsuba_variant()
    lights = _lights(mi, person, light, world_from_camera)
    top, left, height, width = window(person)
    film: dict[str, object] = {
        "pixel_format": "rgba",
        "crop_offset_x": left,
        "crop_offset_y": top,
        "crop_width": width,
        "crop_height": height,
    }
    camera = person.truth.camera
    pose = np.eye(3), np.zeros(3)
    # well spread samples: at 49 of them a third to a half of the noise of independent ones
    spread = "multijitter"
    sensor = mi.load_dict(pinhole(camera, *pose, samples=samples, film=film, sampler=spread))
    path = {"type": "path", "max_depth": _DEPTH, "hide_emitters": True}
    albedo_too = {"type": "aov", "aovs": "albedo:albedo", "paths": path}
    skin = _scene(mi, person, lights, inner_bsdf())
    inside = _render(mi, skin, sensor, albedo_too, 2 * seed)
    direct = {"type": "path", "max_depth": 2, "hide_emitters": True}
    surface = _render(mi, _scene(mi, person, lights, surface_bsdf()), sensor, direct, 2 * seed + 1)

    def whole(part: Float[ndarray, "a b c"]) -> Float[ndarray, "h w c"]:
        out = np.zeros((camera.height, camera.width, part.shape[-1]), np.float32)
        out[top : top + height, left : left + width] = part
        return out

    diffuse, albedo = whole(inside[..., :3]), whole(inside[..., 4:7])
    entering = np.empty((len(patches.areas), 3))
    shown = patches.pixel >= 0
    of_pixel = patches.pixel[shown]
    entering[shown] = (diffuse.reshape(-1, 3) / albedo.reshape(-1, 3).clip(1e-6))[of_pixel]
    by_side = max(1, round(math.sqrt(samples / _PATCH_SAMPLES)))
    entering[~shown] = _entering(
        skin, mi.load_dict(path), person, patches, ~shown, by_side**2, seed
    )
    return Layers(
        diffuse=diffuse,
        specular=whole(surface[..., :3]),
        albedo=albedo,
        cover=whole(inside[..., 3:4])[..., 0],
        entering=entering,
    )


def _lights(
    mi, person: Person, light: DistantLight, world_from_camera: Float[ndarray, "3 3"] | None
) -> dict[str, object]:
    """The scene is in the camera's frame."""
    sky: dict[str, object] = {"type": "envmap", "bitmap": mi.Bitmap(fine_map(light.diffuse))}
    if world_from_camera is not None:
        turn = np.eye(4)
        turn[:3, :3] = world_from_camera.T
        sky["to_world"] = mi.ScalarTransform4f(turn.tolist())
    if light.sun is None:
        return {"sky": sky}
    direction = camera_frame(light.sun.direction, world_from_camera)
    return {"sky": sky, "sun": light.sun.emitter(mi, person.points.mean(0), direction)}


def _entering(
    scene, path, person: Person, patches: SkinPatches, chosen, samples: int, seed: int
) -> Float[ndarray, "c 3"]:
    """Irradiance / pi of the ``chosen`` patches: the radiance that each sends back, / albedo.

    The mean over random places of a patch. Rays start so little above it that nothing comes
    between, whatever the camera sees.
    """
    corners, of_face = patches.corners[chosen], patches.of_face[chosen]
    rng = np.random.default_rng((seed, 7))
    shares = rng.dirichlet(np.ones(3), (len(of_face), samples))  # even over a triangle
    inside = np.einsum("ksc,kcv->ksv", shares, corners)
    vertices = SmoothHead.load().faces[of_face]
    ends = person.points[vertices]
    upright = np.cross(ends[:, 1] - ends[:, 0], ends[:, 2] - ends[:, 0])
    upright /= np.linalg.norm(upright, axis=1, keepdims=True)
    starts = inside @ ends + _LIFT_M * upright[:, None]
    down = np.broadcast_to(-upright[:, None], starts.shape)
    sent = radiance_along(scene, path, starts, down, seed)
    return (sent / (inside @ person.paint.albedo[vertices])).mean(1)


def fine_map(environment: EnvironmentMap) -> Float[ndarray, "h w 3"]:
    """The map as Mitsuba wants it so that each of our pixels is an even patch of light.

    Mitsuba interpolates between columns at pixel centres but rows at v = i / (rows - 1): hence
    8 h + 1 rows, those on our pixels' borders being the mean of both sides.
    """
    ours = convert_latlong(environment.radiance, "skylight", "mitsuba").float()
    columns = ours.repeat_interleave(_FINER, 1)
    rows = torch.cat([columns, columns[-1:]]).repeat_interleave(_FINER, 0)[: 1 - _FINER]
    rows[_FINER:-_FINER:_FINER] = (columns[1:] + columns[:-1]) / 2
    return rows.contiguous().numpy()


def window(person: Person) -> tuple[int, int, int, int]:
    """(top, left, height, width) of the part of the picture that the person is in."""
    camera = person.truth.camera
    points = person.points
    if person.cap is not None:
        points = np.concatenate([points, person.cap.points])
    seen = camera.project(torch.from_numpy(points)).numpy()
    sides = np.array([camera.width, camera.height])
    low = np.clip(np.floor(seen.min(0)).astype(int) - _MARGIN, 0, sides - 8)
    high = np.clip(np.ceil(seen.max(0)).astype(int) + _MARGIN, low + 8, sides)
    return int(low[1]), int(low[0]), int(high[1] - low[1]), int(high[0] - low[0])


def inner_bsdf() -> dict[str, object]:
    """What leaves the inside of skin, eyes and hair of the colours on their vertices."""
    colours = {"type": "mesh_attribute", "name": "vertex_albedo"}
    return {"type": "diffuse", "reflectance": colours}


def surface_bsdf() -> dict[str, object]:
    """What the surface reflects, as rough as the vertices say."""
    return {
        "type": "principled",
        "base_color": {"type": "rgb", "value": 0.0},
        "roughness": {"type": "mesh_attribute", "name": "vertex_roughness"},
        "eta": INDEX,
        "diffuse_reflectance_sampling_rate": 0.0,
    }


def _scene(mi, person: Person, lights: dict[str, object], bsdf):
    head = SmoothHead.load()
    eyes = head.belongs[Region.EYEBALL] > 0.5
    roughness = np.where(eyes, EYE_ROUGHNESS, person.paint.roughness)
    content: dict[str, object] = {
        "type": "scene",
        **lights,
        "head": _mesh(mi, person.points, head.faces, person.paint.albedo, roughness, bsdf),
    }
    if person.cap is not None:
        many = len(person.cap.points)
        colour, rough = np.tile(person.paint.hair, (many, 1)), np.full(many, HAIR_ROUGHNESS)
        content["cap"] = _mesh(mi, person.cap.points, person.cap.faces, colour, rough, bsdf)
    return mi.load_dict(content)


def _render(mi, scene, sensor, integrator, seed: int) -> Float[ndarray, "h w c"]:
    picture = mi.render(scene, sensor=sensor, integrator=mi.load_dict(integrator), seed=seed)
    return np.array(picture, dtype=np.float32)


def _mesh(mi, points, faces, albedo, roughness, bsdf):
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": bsdf})
    mesh = mi.Mesh(
        "mesh",
        vertex_count=len(points),
        face_count=len(faces),
        has_vertex_normals=True,
        props=properties,
    )
    mesh.add_attribute("vertex_albedo", 3, albedo.astype(np.float32).ravel())
    mesh.add_attribute("vertex_roughness", 1, roughness.astype(np.float32).ravel())
    content = mi.traverse(mesh)
    content["vertex_positions"] = points.astype(np.float32).ravel()
    content["vertex_normals"] = normals_of(points, faces).astype(np.float32).ravel()
    content["faces"] = faces.astype(np.uint32).ravel()
    content.update()
    return mesh
