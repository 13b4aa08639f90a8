"""An object of known shape in its picture: which pixels to use, and how light reaches them."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from skylight.errors import InputError
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid
from skylight.transport._cameras import PlacedCamera
from skylight.transport._interreflection import BouncingMesh
from skylight.transport._matrix import TransportMatrix, diffuse_transport
from skylight.transport._observation import Observation
from skylight.transport._rays import Raycaster
from skylight.transport._reflection import shade, specular_transport
from skylight.transport._render import GBuffer, Specular, rasterize
from skylight.work._progress import Progress

GRID_HEIGHT = 32
MOST_PIXELS, FEWEST_PIXELS = 4000, 60
LONGEST_SIDE_PX = 1024  # larger pictures are averaged down: rays go through pixels' centres only
GRAZING_COSINE = 0.15
# Reflection sampled at the grid's directions is then off by 1 % (at most 5 %); by 7 % at 0.2.
SMOOTHEST = 0.25
_BLOCK_PIXELS = 4096


@dataclass(frozen=True, kw_only=True)
class ObjectMaterial:
    """``albedo``/pi plus ``share`` times a GGX lobe, the same all over the object.

    The default, a diffuse surface of albedo 1, folds a grey albedo into the brightness of the
    light. A metal has albedo 0 and a ``specular`` whose ``f0`` is its reflectance. Light
    ``bounces`` so often between parts of the object, in every colour as much as in luminance: of a
    saturated albedo, three times as strong in one channel as in another, what a bounce adds is up
    to 60 % off in the weaker one.
    """

    albedo: tuple[float, float, float] = (1.0, 1.0, 1.0)
    specular: Specular | None = None
    share: float = 1.0
    bounces: int = 0

    def __post_init__(self) -> None:
        if self.bounces < 0:
            raise InputError(f"bounces must be 0 or more, got {self.bounces}")
        if self.bounces and self.albedo == (1.0, 1.0, 1.0):
            raise InputError("how much light bounces on depends on the albedo: give it")
        if not all(0 <= value <= 1 for value in self.albedo):
            raise InputError(f"albedo must be from 0 to 1, got {self.albedo}")
        if min(self.albedo) == 0 and (max(self.albedo) > 0 or self.specular is None):
            raise InputError(
                f"albedo {self.albedo} reflects no light of some colour, which cannot be recovered "
                "then: give values above 0 (or 0 in all three for a metal with a roughness)"
            )
        if self.specular is not None:
            if not SMOOTHEST <= self.specular.roughness <= 1:
                raise InputError(
                    f"roughness must be from {SMOOTHEST} to 1, got {self.specular.roughness:g}: "
                    "smoother surfaces show more detail than the light's grid holds"
                )
            if not 0 < self.specular.f0 <= 1:
                raise InputError(
                    f"reflectance must be above 0 and at most 1, got {self.specular.f0:g}"
                )
            if not self.share > 0:
                raise InputError(
                    f"the share of specular reflection must be above 0, got {self.share:g}"
                )


@dataclass(frozen=True, kw_only=True)
class ObjectView:
    """An object in its picture, and the points on it that were used.

    ``surface`` is what the ``camera`` sees of the mesh, in the camera's frame; ``observation``
    holds some of its pixels, with transport over a grid of directions in the mesh's world, where
    light bounces on ``mesh``.
    """

    picture: Float[Tensor, "h w 3"]
    camera: PlacedCamera
    surface: GBuffer
    raycaster: Raycaster
    material: ObjectMaterial
    observation: Observation
    mesh: BouncingMesh

    def shade(self, environment: EnvironmentMap, points: Int[Tensor, " k"]) -> Float[Tensor, "k 3"]:
        """What these of the surface's points send to the camera under a light of the world."""
        grid = self.observation.transport.grid
        assert grid.layout is not None
        light = environment.resize(grid.layout[0]).flat
        shades = []
        for some in points.split(_BLOCK_PIXELS):
            diffuse, specular = _transport(
                self.surface, some, self.raycaster, self.camera, grid, self.material, self.mesh
            )
            shades.append(shading(diffuse, specular, light, self.material))
        return torch.cat(shades)


def observe_object(
    vertices: Float[Tensor, "n 3"],
    faces: Int[Tensor, "f 3"],
    camera: PlacedCamera,
    picture: Float[Tensor, "h w 3"],
    *,
    mask: Bool[Tensor, "mask_h mask_w"] | None = None,
    clipped: Bool[Tensor, "h w"] | None = None,
    material: ObjectMaterial | None = None,
    progress: Progress | None = None,
) -> ObjectView:
    """Pick up to 4,000 of the pixels that show the object and trace their transport.

    Left out are pixels at the outline, which mix with what lies behind, those seen at a slant of
    more than 81 degrees, and over-exposed ones. Pictures of more than 1024 pixels a side are
    averaged down by a whole factor. Of the pixels that remain, some are drawn with a fixed seed.

    Parameters
    ----------
    picture : linear radiance.
    mask : True where the picture shows the object and nothing before it.
    clipped : True where the picture was over-exposed.

    Raises
    ------
    InputError
        The picture is not finite or has another size than camera or mask, the camera does not see
        the mesh, or too few pixels remain.
    """
    material = material or ObjectMaterial()
    _check_picture(picture, camera, mask)
    usable = torch.ones(picture.shape[:2], dtype=torch.bool) if mask is None else mask
    good = usable if clipped is None else usable & ~clipped
    picture, camera, usable, good = _shrunk(picture, camera, usable, good)
    placed = camera.world_from_camera.inverse().points(vertices.double())
    raycaster = Raycaster(placed, faces)
    surface = rasterize(camera.camera, placed, faces, raycaster)
    if not len(surface):
        raise InputError(
            "the camera does not see the mesh: check its position, look_at and field of view, and "
            "that they are in the mesh's units and axes"
        )
    points = _chosen(surface, usable, good)
    rows, columns = surface.pixels[points].unbind(1)
    seen = picture[rows, columns].float()
    if not float(seen.max()) > 0:
        raise InputError("the object is black in the picture: it tells nothing about the light")
    grid = DirectionGrid.latlong(GRID_HEIGHT)
    mesh = BouncingMesh(
        vertices=vertices.double(),
        faces=faces,
        raycaster=Raycaster(vertices.double(), faces),
        albedo=float(luminance(torch.tensor(material.albedo))),
    )
    diffuse, specular = _transport(
        surface, points, raycaster, camera, grid, material, mesh, progress=progress
    )
    # pixels seen at a slant cover more of the surface each and lie less surely
    observation = Observation(
        pixels=seen,
        weights=_facing(surface)[points].float(),
        places=surface.pixels[points],
        transport=diffuse,
        specular=specular,
    )
    return ObjectView(
        picture=picture,
        camera=camera,
        surface=surface,
        raycaster=raycaster,
        material=material,
        observation=observation,
        mesh=mesh,
    )


def _check_picture(
    picture: Float[Tensor, "h w 3"],
    placed: PlacedCamera,
    mask: Bool[Tensor, "mask_h mask_w"] | None,
) -> None:
    height, width = picture.shape[:2]
    camera = placed.camera
    if (camera.height, camera.width) != (height, width):
        raise InputError(
            f"the camera is for a picture of {camera.width}x{camera.height} pixels, this one has "
            f"{width}x{height}: describe the camera of this picture"
        )
    if mask is not None and tuple(mask.shape) != (height, width):
        raise InputError(
            f"the mask has {mask.shape[1]}x{mask.shape[0]} pixels, the picture {width}x{height}: "
            "draw the mask over the picture itself"
        )
    if not bool(picture.isfinite().all()):
        raise InputError("the picture holds NaN or infinite pixels; repair or replace them")


def _shrunk(
    picture: Float[Tensor, "h w 3"],
    camera: PlacedCamera,
    usable: Bool[Tensor, "h w"],
    good: Bool[Tensor, "h w"],
) -> tuple[Float[Tensor, "h2 w2 3"], PlacedCamera, Bool[Tensor, "h2 w2"], Bool[Tensor, "h2 w2"]]:
    """Picture and camera averaged down, where too large; a block is as good as its worst pixel."""
    factor = math.ceil(max(picture.shape[:2]) / LONGEST_SIDE_PX)
    if factor == 1:
        return picture, camera, usable, good
    height, width = picture.shape[0] // factor, picture.shape[1] // factor

    def blocks(image: Tensor) -> Tensor:
        cut = image[: height * factor, : width * factor]
        return cut.reshape(height, factor, width, factor, -1).transpose(1, 2).flatten(2, 3)

    return (
        blocks(picture).mean(2),
        camera.shrunk(factor),
        blocks(usable).all(2)[..., 0],
        blocks(good).all(2)[..., 0],
    )


def _chosen(
    surface: GBuffer, usable: Bool[Tensor, "h w"], good: Bool[Tensor, "h w"]
) -> Int[Tensor, " k"]:
    """Which of the surface's pixels to use, at most MOST_PIXELS, in order."""
    rows, columns = surface.pixels.unbind(1)
    covered = surface.image(torch.ones(len(surface), 1))[..., 0].numpy()
    inner = cv2.erode(covered, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
    inside = torch.from_numpy(inner)[rows, columns] > 0
    shown = inside & (_facing(surface) > GRAZING_COSINE) & usable[rows, columns]
    points = torch.nonzero(shown & good[rows, columns])[:, 0]
    if len(points) < FEWEST_PIXELS:
        total = int(shown.sum())
        if total < FEWEST_PIXELS:
            raise InputError(
                f"only {total} pixels show the object ({len(surface)} lie on the mesh): check the "
                "camera and the mask, or give a larger picture"
            )
        raise InputError(
            f"{total - len(points)} of {total} pixels of the object are over-exposed: give a "
            "picture with a shorter exposure"
        )
    if len(points) > MOST_PIXELS:
        drawn = torch.randperm(len(points), generator=torch.Generator().manual_seed(0))
        points = points[drawn[:MOST_PIXELS].sort().values]
    return points


def _facing(surface: GBuffer) -> Float[Tensor, " m"]:
    """Cosine between normal and view."""
    return -(surface.normals * normalize(surface.positions, dim=1)).sum(1)


def _transport(
    surface: GBuffer,
    points: Int[Tensor, " k"],
    raycaster: Raycaster,
    camera: PlacedCamera,
    grid: DirectionGrid,
    material: ObjectMaterial,
    mesh: BouncingMesh,
    *,
    progress: Progress | None = None,
) -> tuple[TransportMatrix, TransportMatrix | None]:
    """Diffuse and specular transport of surface points, over a grid of directions in the world.

    Rays are cast in the camera's frame, where the surface is; columns belong to the same
    directions named in the world's.
    """
    turned = DirectionGrid(
        directions=camera.world_from_camera.inverse().directions(grid.directions.double()),
        solid_angles=grid.solid_angles,
        layout=grid.layout,
    )
    diffuse = diffuse_transport(
        surface.origins[points],
        surface.normals[points],
        surface.geometric_normals[points],
        raycaster,
        turned,
        progress=progress,
    )
    specular = None
    if material.specular is not None:
        view = -normalize(surface.positions[points], dim=1)
        shiny = specular_transport(diffuse, surface.normals[points], view, material.specular)
        specular = TransportMatrix(matrix=shiny.matrix, grid=grid)
    world = mesh.transport(
        TransportMatrix(matrix=diffuse.matrix, grid=grid),
        camera.world_from_camera.points(surface.origins[points].double()),
        camera.world_from_camera.directions(surface.normals[points].double()),
        bounces=material.bounces,
    )
    return world, specular


def shading(
    diffuse: TransportMatrix,
    specular: TransportMatrix | None,
    light: Float[Tensor, "*b n 3"],
    material: ObjectMaterial,
) -> Float[Tensor, "*b m 3"]:
    """albedo T l + share G l."""
    shading = torch.tensor(material.albedo).to(light) * shade(diffuse.matrix, light)
    return shading if specular is None else shading + material.share * shade(specular.matrix, light)
