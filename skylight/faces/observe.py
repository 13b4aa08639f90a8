"""The observation of a fitted face: pixels, weights and transport."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.errors import InputError
from skylight.faces.detection.blazeface import Square
from skylight.faces.fit import FaceFit
from skylight.faces.model import HeadModel, Region
from skylight.faces.normal_errors import normal_error_modes
from skylight.faces.segmentation.hair import hair_probability
from skylight.faces.segmentation.skin_inliers import inlier_probability
from skylight.faces.segmentation.skin_mask import SkinLikeness
from skylight.faces.skin import pigment_modes
from skylight.sphere.envmap import luminance
from skylight.sphere.grid import DirectionGrid
from skylight.transport.camera import Camera
from skylight.transport.gbuffer import GBuffer, rasterize
from skylight.transport.gloss import camera_lamp, glossy_transport
from skylight.transport.matrix import TransportMatrix, diffuse_transport
from skylight.transport.normal_modes import NormalModes
from skylight.transport.observation import Observation
from skylight.transport.raycast import Raycaster
from skylight.transport.render import Specular
from skylight.work.progress import Progress

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
NORMAL_ROWS = 32  # of the light that normal errors are seen in: cells of 5.6 degrees
# The rest of the head tells where a sun behind the face stands, where it is bare: parts, and how
# dark against the face their skin may be. What is above a hairline is lit from the sky.
BARE_PARTS = {Region.EAR: 0.3, Region.NECK: 0.25, Region.SCALP: 0.7}
# Index of refraction 1.4; the roughness is nominal, and its strength is estimated per face.
SKIN_GLOSS = Specular(f0=0.028, roughness=0.5)


@dataclass(frozen=True, kw_only=True)
class FaceView:
    """A face cut out of a picture at working resolution, with the points seen in it.

    ``used`` (m,) tells which of the G-buffer's pixels went into ``observation``, in order.
    """

    image: Float[Tensor, "h w 3"]
    camera: Camera
    surface: GBuffer
    used: Bool[Tensor, " m"]
    observation: Observation


def observe_face(
    picture: Float[Tensor, "h w 3"],
    clipped: Bool[Tensor, "h w"],
    model: HeadModel,
    fit: FaceFit,
    *,
    face_height_px: int = 72,
    grid_height: int = 64,
    specular: Specular | None = SKIN_GLOSS,
    grey: bool = False,
    workers: int = 1,
    progress: Progress | None = None,
) -> FaceView:
    """Cut out the face, pick its pixels and trace their transport.

    Visibility comes from the whole head, so nose, brows and chin cast their shadows. Pixels are
    those of the face's skin and of what else of the head is bare (:class:`SkinLikeness`): of a sun
    behind the person, the face itself sees nothing. What no light on skin explains is left out,
    and the rest is weighted by how likely it is skin (:func:`inlier_probability`). Over-exposed
    ones count as lower bounds. ``specular`` is the surface's reflection, None where its transport
    is not wanted. ``grey``: the picture has no colour.
    ``face_height_px`` is the height of the skin region after down-sampling (never up): beyond
    90 px estimates hardly change (thesis, 5.5.5.1), while memory grows: the transport takes
    4 * pixels * 2 * grid_height**2 bytes, 100 MB for 3,000 pixels and 64 rows, that of the
    gloss as much, and what normals may be wrong by a quarter of it.
    """
    vertices, faces = torch.from_numpy(fit.vertices), torch.from_numpy(model.faces.copy())
    hair = hair_probability(picture, _around_head(model, fit))
    image, camera, (clipped_share, hair_share) = _cut_out(
        picture, [clipped.float().numpy(), hair], model, fit, face_height_px
    )
    raycaster = Raycaster(vertices, faces)
    surface = rasterize(camera, vertices, faces, raycaster)
    view = -torch.nn.functional.normalize(surface.positions, dim=1)
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
    transport = diffuse_transport(
        surface.origins[used],
        surface.normals[used],
        surface.geometric_normals[used],
        raycaster,
        DirectionGrid.latlong(grid_height),
        workers=workers,
        progress=progress,
    )
    gloss = None
    if specular is not None:
        gloss = glossy_transport(transport, surface.normals[used], view[used], specular)
    # pixels seen at a slant cover more skin each and lie less surely: weight by the cosine
    all_of_it = Observation(
        pixels=seen[used],
        weights=facing[used].float(),
        places=surface.pixels[used],
        transport=transport,
        gloss=gloss,
        clipped=over[used] if bool(over[used].any()) else None,
        grey=grey,
        modes=_modes(surface, used, model),
        normal_modes=_normal_modes(surface, used, model, fit, transport),
        camera_lamp=camera_lamp(surface.normals[used], view[used], specular).float(),
    )
    inlier = inlier_probability(all_of_it)
    kept = inlier > LEAST_INLIER
    _require_enough(kept & ~over[used], on_skin)
    observation = _skin_of(all_of_it, inlier, kept)
    used[used.clone()] = kept
    return FaceView(image=image, camera=camera, surface=surface, used=used, observation=observation)


def _require_enough(usable: Bool[Tensor, " k"], on_skin: Bool[Tensor, " m"]) -> None:
    if int(usable.sum()) < FEWEST_PIXELS:
        raise InputError(
            f"only {int(usable.sum())} usable pixels on the face ({int(on_skin.sum())} of "
            "skin): it is too small, over-exposed, too dark or turned away"
        )


def _skin_of(
    seen: Observation, inlier: Float[Tensor, " m"], kept: Bool[Tensor, " m"]
) -> Observation:
    """The ``kept`` pixels, weighted by how likely each is skin too."""

    def rows(transport: TransportMatrix) -> TransportMatrix:
        return replace(transport, matrix=transport.matrix[kept])

    return replace(
        seen,
        pixels=seen.pixels[kept],
        weights=(seen.weights * inlier)[kept],
        places=seen.places[kept],
        transport=rows(seen.transport),
        gloss=None if seen.gloss is None else rows(seen.gloss),
        clipped=None if seen.clipped is None else seen.clipped[kept],
        modes=None if seen.modes is None else seen.modes[kept],
        normal_modes=None if seen.normal_modes is None else seen.normal_modes.rows(kept),
        camera_lamp=None if seen.camera_lamp is None else seen.camera_lamp[kept],
    )


def _modes(surface: GBuffer, used: Bool[Tensor, " m"], model: HeadModel) -> Float[Tensor, "u k"]:
    """How pigments may vary at the used pixels: the modes of their triangles' corners."""
    corners = torch.from_numpy(pigment_modes()[model.faces[surface.faces[used].numpy()]])
    return (corners * surface.barycentric[used][..., None]).sum(1).float()


def _normal_modes(
    surface: GBuffer,
    used: Bool[Tensor, " m"],
    model: HeadModel,
    fit: FaceFit,
    transport: TransportMatrix,
) -> NormalModes | None:
    """How the used pixels' normals may be wrong; None where the head is known."""
    modes = normal_error_modes(model, fit, surface, used)
    if modes is None:
        return None
    return NormalModes.of(transport, surface.normals[used], modes, NORMAL_ROWS)


def _cut_out(
    picture: Float[Tensor, "h w 3"],
    maps: list[Float[np.ndarray, "h w"]],
    model: HeadModel,
    fit: FaceFit,
    face_height_px: int,
) -> tuple[Float[Tensor, "h2 w2 3"], Camera, list[Float[Tensor, "h2 w2"]]]:
    """The head's part of the picture, area-averaged, its camera, and so the ``maps``."""
    camera = fit.camera
    image = camera.project(torch.from_numpy(fit.vertices)).numpy()
    skin = image[model.regions == Region.FACE]
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


def _around_head(model: HeadModel, fit: FaceFit) -> Square:
    """The square in which hair is looked for: about the face, and upright with it."""
    skin = fit.camera.project(torch.from_numpy(fit.vertices[model.regions == Region.FACE])).numpy()
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
