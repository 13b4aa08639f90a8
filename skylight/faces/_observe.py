"""The observation of a fitted face: pixels, weights and transport."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from skylight.errors import InputError
from skylight.faces._background import BackgroundPixels
from skylight.faces._blazeface import Square
from skylight.faces._fit import FaceFit
from skylight.faces._model import HeadModel, Region
from skylight.faces._normal_errors import normal_error_modes
from skylight.faces._segmentation import SkinLikeness, hair_probability
from skylight.faces._skin import pigment_modes
from skylight.faces._skin_inliers import LIGHT_ROWS, inlier_probability
from skylight.sphere._envmap import luminance
from skylight.transport._cameras import Camera
from skylight.transport._interreflection import BouncingMesh
from skylight.transport._matrix import TransportMatrix
from skylight.transport._normal_modes import NormalModes
from skylight.transport._observation import Observation
from skylight.transport._rays import Raycaster, TorchRaycaster
from skylight.transport._reflection import camera_lamp, specular_transport
from skylight.transport._render import GBuffer, Specular, rasterize
from skylight.transport._visibility import PixelBlocks, adaptive_visibility
from skylight.work._progress import Progress

# Left out: pixels that the camera sees at more than 75 degrees,
GRAZING_COSINE = 0.25
# those darker than this part of the face's 90th percentile (nostrils, black),
DARK_SHARE = 0.01
# and those that no light on skin explains (glasses, beards, strands of hair), by this probability.
LEAST_INLIER = 0.5
# Where more than this part was over-exposed, the light is known to have been at least so bright.
CLIPPED_SHARE = 0.02
# Where hair is likelier than this, there is no skin,
HAIR_SHARE = 0.5
# of hair looked for in a square of so many times the height of the face.
HAIR_SQUARE = 2.0
FEWEST_PIXELS = 60
BLOCK = 2  # pixels abreast in what is observed of faces that are as high as this, or higher:
LEAST_HEIGHT_PX = 48
NORMAL_ROWS = 32  # of the light that normal errors are seen in: cells of 5.6 degrees
# The rest of the head tells where a sun behind the face stands, where it is bare: parts, and how
# dark against the face their skin may be. What is above a hairline is lit from the sky.
BARE_PARTS = {Region.EAR: 0.3, Region.NECK: 0.25, Region.SCALP: 0.7}
# Index of refraction 1.4; the roughness is nominal, and its strength is estimated per face.
SKIN_SPECULAR = Specular(f0=0.028, roughness=0.5)
# luminance of the mean over the modes of the skin prior, by which light bounces on a head
BOUNCING_ALBEDO = 0.12


@dataclass(frozen=True, kw_only=True)
class FaceView:
    """A face cut out of a picture at working resolution, with the points seen in it.

    ``used`` (m,) tells which of the G-buffer's pixels went into ``observation``, and ``blocks``
    (u,) into which of its rows each of those did. ``behind`` is where the whole photograph
    shows its background. ``no_background`` is why the observation has none, None where it has or
    was not to have.
    """

    image: Float[Tensor, "h w 3"]
    camera: Camera
    surface: GBuffer
    used: Bool[Tensor, " m"]
    blocks: Int[Tensor, " u"]
    observation: Observation
    behind: BackgroundPixels | None = None
    no_background: str | None = None

    @property
    def places(self) -> Int[Tensor, "u 2"]:
        """(row, column) in ``image`` of each used pixel."""
        return self.surface.pixels[self.used]


def observe_face(
    picture: Float[Tensor, "h w 3"],
    clipped: Bool[Tensor, "h w"],
    model: HeadModel,
    fit: FaceFit,
    *,
    face_height_px: int = 72,
    grid_height: int = 64,
    specular: Specular | None = SKIN_SPECULAR,
    grey: bool = False,
    bounces: int = 0,
    beside: Sequence[FaceFit] | None = (),
    workers: int = 1,
    rays_on: torch.device | None = None,
    progress: Progress | None = None,
) -> FaceView:
    """Cut out the face, pick its pixels and trace their transport.

    Visibility comes from the whole head, so nose, brows and chin cast their shadows. Pixels are
    those of the face's skin and of what else of the head is bare (:class:`SkinLikeness`): of a sun
    behind the person, the face itself sees nothing. What no light on skin explains is left out,
    and the rest is weighted by how likely it is skin (:func:`inlier_probability`). Over-exposed
    ones count as lower bounds. ``specular`` is the surface's reflection, None where its transport
    is not wanted. ``grey``: the picture has no colour. ``bounces``: how often light may bounce on
    the head, of :data:`BOUNCING_ALBEDO`, before it reaches a pixel. ``beside``: other heads that
    were fitted in the picture, which are cut out of the background too; None leaves the background
    out. ``rays_on``: the device on
    which the rays of visibility are cast, by PyTorch; None for embree and ``workers``. Both see the
    same (:class:`~skylight.transport._rays.TorchRaycaster`); on a CPU embree is faster.

    ``face_height_px`` is the height of the skin region after down-sampling (never up): beyond
    90 px estimates hardly change (thesis, 5.5.5.1), while rays grow. From 48 px on the observation
    has means over blocks of 2 x 2 pixels, which say as much: a face's pixels are not independent.
    Memory: 2 * pixels * 2 * grid_height**2 bytes while rays are cast, 50 MB for 3,000 pixels and
    64 rows; the transport of the blocks takes half as much, that of the specular reflection as
    much, and what normals may be wrong by a quarter of it.
    """
    vertices, faces = torch.from_numpy(fit.vertices), torch.from_numpy(model.faces.copy())
    hair = hair_of(picture, model, fit)
    image, camera, (clipped_share, hair_share) = _cut_out(
        picture, [clipped.float().numpy(), hair], model, fit, face_height_px
    )
    raycaster = Raycaster(vertices, faces)
    surface = rasterize(camera, vertices, faces, raycaster)
    view = -normalize(surface.positions, dim=1)
    facing = (surface.normals * view).sum(1)
    rows, columns = surface.pixels.unbind(1)
    over = clipped_share[rows, columns] > CLIPPED_SHARE
    on_skin = _bare_skin(
        image,
        clipped_share > CLIPPED_SHARE,
        hair_share > HAIR_SHARE,
        surface,
        facing,
        model,
    )
    seen = image[rows, columns]
    if not bool(on_skin.any()):
        raise InputError("the face is turned away: no skin of it faces the camera")
    bright = torch.quantile(luminance(seen[on_skin]), 0.9)
    used = on_skin & (luminance(seen) > DARK_SHARE * bright)
    _require_enough(used & ~over, on_skin)
    sight = adaptive_visibility(
        surface.origins[used],
        surface.normals[used],
        surface.geometric_normals[used],
        raycaster if rays_on is None else TorchRaycaster(vertices, faces, rays_on),
        grid_height,
        workers=workers,
        progress=progress,
    )
    coarse = sight.transport(min(grid_height, LIGHT_ROWS))
    views = view[used]
    reflected = None
    if specular is not None:
        reflected = specular_transport(coarse, surface.normals[used], views, specular)
    # pixels seen at a slant cover more skin each and lie less surely: weight by the cosine
    by_pixel = Observation(
        pixels=seen[used],
        weights=facing[used].float(),
        places=surface.pixels[used],
        transport=coarse,
        specular=reflected,
        clipped=over[used] if bool(over[used].any()) else None,
    )
    inlier = inlier_probability(by_pixel)
    kept = inlier > LEAST_INLIER
    _require_enough(kept & ~over[used], on_skin)
    weights = torch.where(kept, by_pixel.weights * inlier, 0.0)
    height = min(face_height_px, float(np.ptp(skin_seen(model, fit)[:, 1])))
    size = BLOCK if height >= LEAST_HEIGHT_PX else 1
    blocks = PixelBlocks.of(by_pixel.places, weights, by_pixel.clipped, size)
    normals = normalize(blocks.means(surface.normals[used]), dim=1)
    views = normalize(blocks.means(views), dim=1)
    transport = TransportMatrix(matrix=blocks.means(sight), grid=sight.grid)
    points = used.nonzero()[:, 0][blocks.heaviest()]
    mesh = BouncingMesh(vertices=vertices, faces=faces, raycaster=raycaster, albedo=BOUNCING_ALBEDO)
    errors = normal_error_modes(model, fit, surface, points)
    observation = Observation(
        pixels=blocks.means(by_pixel.pixels),
        weights=blocks.weights,
        places=blocks.places,
        transport=mesh.transport(
            transport, surface.origins[points], normals, bounces=bounces, workers=workers
        ),
        specular=None
        if specular is None
        else specular_transport(transport, normals, views, specular),
        clipped=blocks.clipped,
        grey=grey,
        modes=_modes(surface, points, model),
        normal_modes=None
        if errors is None
        else NormalModes.of(transport, normals, errors.modes, NORMAL_ROWS, errors.axes),
        camera_lamp=camera_lamp(normals, views, specular).float(),
    )
    behind = why_not = None
    if beside is not None:
        hair = np.maximum.reduce([hair, *(hair_of(picture, model, one) for one in beside)])
        try:
            behind = BackgroundPixels.of(picture, clipped, [fit, *beside], hair)
            background = behind.observed(observation.mean_luminance, grid_height)
            observation = replace(observation, background=background)
        except InputError as error:
            why_not = str(error)
    used[used.clone()] = weights > 0
    return FaceView(
        image=image,
        camera=camera,
        surface=surface,
        used=used,
        blocks=blocks.index,
        observation=observation,
        behind=behind,
        no_background=why_not,
    )


def _require_enough(usable: Bool[Tensor, " k"], on_skin: Bool[Tensor, " m"]) -> None:
    if int(usable.sum()) < FEWEST_PIXELS:
        raise InputError(
            f"only {int(usable.sum())} usable pixels on the face ({int(on_skin.sum())} of "
            "skin): it is too small, over-exposed, too dark or turned away"
        )


def _modes(surface: GBuffer, points: Int[Tensor, " u"], model: HeadModel) -> Float[Tensor, "u k"]:
    """How pigments may vary at some of the pixels: the modes of their triangles' corners."""
    corners = torch.from_numpy(pigment_modes()[model.faces[surface.faces[points].numpy()]])
    return (corners * surface.barycentric[points][..., None]).sum(1).float()


def _cut_out(
    picture: Float[Tensor, "h w 3"],
    maps: list[Float[np.ndarray, "h w"]],
    model: HeadModel,
    fit: FaceFit,
    face_height_px: int,
) -> tuple[Float[Tensor, "h2 w2 3"], Camera, list[Float[Tensor, "h2 w2"]]]:
    """The head's part of the picture, area-averaged, its camera, and so the ``maps``."""
    camera = fit.camera
    skin = skin_seen(model, fit)
    scale = min(1.0, face_height_px / np.ptp(skin[:, 1]))
    margin = 0.35 * np.ptp(skin[:, 1])
    low = np.floor(np.maximum(skin.min(0) - margin, 0)).astype(int)
    high = np.ceil(np.minimum(skin.max(0) + margin, [camera.width, camera.height])).astype(int)
    if (high - low < 16).any():
        raise InputError("the face lies outside the picture or is too small to use")
    size = np.maximum(np.round((high - low) * scale), 1).astype(int)
    window = (slice(low[1], high[1]), slice(low[0], high[0]))
    area = (int(size[0]), int(size[1]))
    part = np.ascontiguousarray(picture[window].numpy())
    small = cv2.resize(part, area, interpolation=cv2.INTER_AREA)
    shares = [
        torch.from_numpy(
            cv2.resize(np.ascontiguousarray(each[window]), area, interpolation=cv2.INTER_AREA)
        )
        for each in maps
    ]
    ratio = size / (high - low)
    cut = Camera(
        focal_px=camera.focal_px * float(ratio.mean()),
        width=area[0],
        height=area[1],
        center_px=(
            float((camera.center_px[0] - low[0]) * ratio[0]),
            float((camera.center_px[1] - low[1]) * ratio[1]),
        ),
    )
    return torch.from_numpy(small), cut, shares


def skin_seen(model: HeadModel, fit: FaceFit) -> Float[np.ndarray, "k 2"]:
    """Where the picture has the vertices of the face's skin, pixels."""
    return fit.camera.project(torch.from_numpy(fit.vertices[model.regions == Region.FACE])).numpy()


def hair_of(
    picture: Float[Tensor, "h w 3"], model: HeadModel, fit: FaceFit
) -> Float[np.ndarray, "h w"]:
    """How likely each pixel shows the person's hair (:func:`hair_probability`).

    It is looked for in a square about the face, :data:`HAIR_SQUARE` times as large.
    """
    return hair_probability(picture, _around_head(model, fit))


def _around_head(model: HeadModel, fit: FaceFit) -> Square:
    """The square in which hair is looked for: about the face, and upright with it."""
    skin = skin_seen(model, fit)
    right, up = fit.rotation[:2, 0]  # where the head's own left points to: +X right, +Y up
    return Square(
        centre=(skin.min(0) + skin.max(0)) / 2,
        side=float(HAIR_SQUARE * np.ptp(skin, axis=0).max()),
        angle_rad=float(np.arctan2(-up, right)),
    )


def _bare_skin(
    image: Float[Tensor, "h w 3"],
    clipped: Bool[Tensor, "h w"],
    hair: Bool[Tensor, "h w"],
    surface: GBuffer,
    facing: Float[Tensor, " m"],
    model: HeadModel,
) -> Bool[Tensor, " m"]:
    """The surface's pixels that show skin, on the face and wherever else the head is bare of hair.

    Their eight neighbours show the same part: borders mix with what lies beside. Elsewhere than on
    the face, over-exposed skin is skin where what is not over-exposed beside it is.
    """
    linear, white, bald = image.numpy(), clipped.numpy(), ~hair.numpy()

    def mask(regions: list[Region], *, whole: bool) -> Bool[np.ndarray, "h w"]:
        corners = np.isin(model.regions, regions)[model.faces]
        inside = torch.from_numpy(corners.all(1) if whole else corners.any(1))[surface.faces]
        inside = inside & (facing > GRAZING_COSINE)
        drawn = surface.image(inside.float()[:, None])[..., 0].numpy()
        if whole:
            drawn = cv2.erode(drawn, np.ones((3, 3), np.uint8), borderValue=0)
        return drawn > 0

    face = mask([Region.FACE], whole=True) & bald
    if not (face & ~white).any():
        return torch.from_numpy(face)[surface.pixels[:, 0], surface.pixels[:, 1]]
    head = mask([Region.FACE, *BARE_PARTS], whole=False) & bald
    likeness = SkinLikeness.of(linear, face, white)
    skin = face.copy()
    for region, darkest in BARE_PARTS.items():
        skin |= likeness.bare(head, mask([region], whole=True), darkest)
    return torch.from_numpy(skin)[surface.pixels[:, 0], surface.pixels[:, 1]]
