"""A photograph of a person in another light.

With S the diffuse shading of albedo 1 and g the specular reflection, both of the fitted head and in
the colours of the picture, the photograph I under the light found (A) is ``I = rho S_A + g_A``. The
albedo ::

    rho = ((I - g_A) S_A + l rho_0) / (S_A^2 + l)

is regularised towards a local mean rho_0 where shading is dark, and the picture under light B is ::

    rho S_B + g_B + c (I - rho S_A - g_A),

c being what the two lights share: their own residual stays where the light stays. Shadows of A that
lie elsewhere than the fitted head, or the shell of hair over it, has them stay in the albedo.

All of that is computed of what the camera saw: an :class:`~skylight.imaging._edits.Edit` of the
picture is undone before and done after.

Hair, clothes and what else of a person is no skin are multiplied by the ratio of the smoothed
shadings of head and bust, filled beyond these. What lies behind is multiplied by the ratio of the
lights' irradiances of vertical surfaces, in the mean over all azimuths.
"""

import math
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32, Shaped
from numpy import ndarray
from torch import Tensor

from skylight.errors import InputError
from skylight.estimation._kept import FaceReflection, FoundLight
from skylight.faces._fit import FaceFit
from skylight.faces._model import HeadModel, Region
from skylight.faces._observe import SKIN_SPECULAR, hair_of
from skylight.faces._segmentation import person_matte
from skylight.imaging._edits import UNEDITED, Edit
from skylight.imaging._photo import Photo
from skylight.portrait._surface import BUST, FACE_PX, HAIR, PersonSurface
from skylight.sphere._envmap import LUMINANCE, EnvironmentMap, luminance
from skylight.work._progress import Progress


def blurred(
    picture: Float[ndarray, "h w c"], weights: Float[ndarray, "h w"], sigma_px: float
) -> Float[ndarray, "h w c"]:
    """Normalised convolution (Knutsson and Westin 1993): ``G * (w x) / G * w``, G a Gaussian.

    Where no pixel of weight lies near, it tends to 0.
    """
    above = cv2.GaussianBlur(float32(picture * weights[..., None]), (0, 0), sigma_px)
    below = cv2.GaussianBlur(float32(weights), (0, 0), sigma_px)
    return above.reshape(picture.shape) / np.maximum(below, 1e-6)[..., None]


def filled(
    picture: Float[ndarray, "h w c"], weights: Float[ndarray, "h w"]
) -> Float[ndarray, "h w c"]:
    """What weights of 0 to 1 leave unknown, from its surroundings by push and pull (Gortler et al.
    1996): weighted means of ever larger neighbourhoods, interpolated back where detail lacks.
    """
    if min(weights.shape) < 2:
        mean = np.average(picture.reshape(-1, picture.shape[2]), 0, weights.reshape(-1))
        return np.where(weights[..., None] > 0, picture, mean)
    pushed = cv2.pyrDown(float32(picture * weights[..., None]))
    below = cv2.pyrDown(float32(weights))
    coarse = pushed.reshape(*below.shape, -1) / np.maximum(below, 1e-12)[..., None]
    pulled = cv2.pyrUp(
        float32(filled(coarse, np.minimum(4 * below, 1))), dstsize=picture.shape[1::-1]
    )
    known = weights[..., None]
    return known * picture + (1 - known) * pulled.reshape(picture.shape)


def float32(picture: Shaped[ndarray, "*s"]) -> Float32[ndarray, "*s"]:
    """As OpenCV takes it."""
    return np.ascontiguousarray(picture, np.float32)


# Lengths are in heights of the face.
LOCAL = 0.12  # standard deviation of the Gaussian of local means of albedo
SOFT = 0.06  # and of the shading of hair and clothes
DARK = 0.1  # of the mean shading: l is its square
BASE = 0.05  # of the mean shading: what ratios of smoothed shadings have in addition
BRIGHTEST = 1.6  # times the local albedo: what is brighter is a highlight that stays behind
# Of what the skin shows in any channel. Estimates take too much for specular reflection, most of
# all of over-exposed skin; of the darkest skin a correct specular scale is cut too.
MOST_SPECULAR = 0.4
HAIR_COUNTS = 1e-3  # where skin's shading is filled in from, what covered pixels without skin count
SKIN = (Region.FACE, Region.LIPS, Region.EAR, Region.NECK, Region.BROW)
# Of the old picture: nothing more than is no light, the skin's brightness, or all of the place but
# where its light comes from.
Keep = Literal["nothing", "brightness", "place"]
_LUMINANCE = np.array(LUMINANCE, np.float32)
SHARED_ROWS = 16  # cells of 11 degrees: how far a lamp moves until it is another one


@dataclass(frozen=True, kw_only=True)
class Portrait:
    """A photograph taken apart, so that any light can be put in the place of ``found``.

    ``scene`` is the photograph before its ``edit``. ``albedo``, ``residual`` (h,w,3) and ``skin``
    (h,w), how much of a pixel shows skin, are at the photograph's pixels, as is ``matte``, how much
    of one is the person's. At the pixels of ``person``, ``shading`` and ``specular`` (p,q,3) are
    S_A and g_A, ``local`` is rho_0, ``soft`` the smoothed S_A, ``bare`` where skin is, ``inside``
    that without its border, which fades, and ``covered`` where there is any surface. ``mean`` (3,)
    is the mean S_A of skin. ``specular_scale`` is at most that whose mean g_A over skin is
    :data:`MOST_SPECULAR` of the photograph's in each channel.
    """

    photo: Float[ndarray, "h w 3"]
    edit: Edit
    scene: Float[ndarray, "h w 3"]
    person: PersonSurface
    found: EnvironmentMap
    specular_scale: float
    grey: bool
    albedo: Float[ndarray, "h w 3"]
    residual: Float[ndarray, "h w 3"]
    skin: Float[ndarray, "h w"]
    matte: Float[ndarray, "h w"]
    shading: Float[ndarray, "p q 3"]
    specular: Float[ndarray, "p q 3"]
    local: Float[ndarray, "p q 3"]
    soft: Float[ndarray, "p q 3"]
    bare: Float[ndarray, "p q"]
    inside: Float[ndarray, "p q"]
    covered: Float[ndarray, "p q"]
    mean: Float[ndarray, "3"]

    @staticmethod
    def of(
        photo: Float[Tensor, "h w 3"],
        person: PersonSurface,
        found: EnvironmentMap,
        specular_scale: float,
        hair: Float[ndarray, "p q"],
        matte: Float[ndarray, "h w"],
        *,
        grey: bool = False,
        edit: Edit = UNEDITED,
    ) -> "Portrait":
        """From a linear photograph, ``edit`` done to it, and the light ``found`` in its units.

        ``specular_scale`` is the strength of the skin's specular lobe; ``hair``
        is how likely a pixel of ``person`` shows hair.
        """
        picture = float32(edit.undo(photo).numpy())
        shading, specular = _images(person, found, specular_scale, grey=grey)
        small = cv2.resize(picture, shading.shape[1::-1], interpolation=cv2.INTER_AREA)
        regions = person.region_image()
        on_skin = np.isin(regions, SKIN) & (hair < 0.5)
        if not on_skin.any():
            raise InputError("the face is turned away or covered: no skin of it can be relit")
        bare, covered = float32(on_skin), float32(regions >= 0)
        mean, shine = shading[on_skin].mean(0), specular[on_skin].mean(0)
        most = float((MOST_SPECULAR * small[on_skin].mean(0) / np.maximum(shine, 1e-12)).min())
        specular_scale, specular = min(1.0, most) * specular_scale, min(1.0, most) * specular
        lit, face_px = np.maximum(small - specular, 0), person.face_px
        local = blurred(lit * shading, bare, LOCAL * face_px) / np.maximum(
            blurred(shading**2, bare, LOCAL * face_px), 1e-12
        )
        inside = cv2.erode(bare, np.ones((3, 3), np.uint8))
        inside = np.minimum(cv2.GaussianBlur(inside, (0, 0), 1.5), bare)

        size, known = picture.shape[:2], _from_skin(bare, covered)
        dark, usual = _enlarged(shading, known, size), _enlarged(local, known, size)
        shine = _enlarged(specular, known, size)
        least = (DARK * float(mean @ _LUMINANCE)) ** 2
        albedo = (np.maximum(picture - shine, 0) * dark + least * usual) / (dark**2 + least)
        albedo = np.minimum(albedo, BRIGHTEST * usual)
        return Portrait(
            photo=float32(photo.numpy()),
            edit=edit,
            scene=picture,
            person=person,
            found=found,
            specular_scale=specular_scale,
            grey=grey,
            albedo=albedo,
            residual=picture - albedo * dark - shine,
            skin=_resized(inside[..., None], size)[..., 0],
            matte=float32(matte),
            shading=shading,
            specular=specular,
            local=local,
            soft=blurred(shading, covered, SOFT * face_px),
            bare=bare,
            inside=inside,
            covered=covered,
            mean=mean,
        )

    def under(
        self, light: EnvironmentMap, exposure: float = 1.0, *, keep: Keep = "nothing"
    ) -> tuple[Float[ndarray, "h w 3"], float]:
        """The photograph in another light times an exposure, linear, and that exposure.

        ``keep``: "brightness" multiplies ``exposure`` by what leaves the mean shading of skin as
        bright as it was. "place", of the light found but moved: white is balanced so that the mean
        shading of skin keeps its colour, and what lies behind is not relit. Neither can be had of
        light that does not reach the skin, which is shown as it is.
        """
        size, known = self.scene.shape[:2], _from_skin(self.bare, self.covered)
        shading, specular = self.shaded_by(light)
        received = shading[self.bare > 0].mean(0)
        level, gains = 1.0, np.ones(3, np.float32)
        if keep == "brightness" and received.any():
            level = float(self.mean @ _LUMINANCE / (received @ _LUMINANCE))
        if keep == "place" and received.all():
            gains = self.mean / received
            gains *= (received @ _LUMINANCE) / ((gains * received) @ _LUMINANCE)
        shading, specular = level * gains * shading, level * gains * specular
        common = shared_light(self.found, light)
        lit = _enlarged(shading, known, size)
        skin = self.albedo * lit + _enlarged(specular, known, size) + common * self.residual
        soft = blurred(shading, self.covered, SOFT * self.person.face_px)
        base = BASE * float(self.mean @ _LUMINANCE)
        ratio = np.log((soft + base) / (self.soft + base))
        other = self.scene * np.exp(_enlarged(ratio, self.covered, size))
        share, within = self.skin[..., None], self.matte[..., None]
        person = share * skin + (1 - share) * other
        behind = self.scene if keep == "place" else self.scene * (level * self._behind(light))
        picture = np.maximum(within * person + (1 - within) * behind, 0)
        # what an edit made black is not known again: where nothing changed, nothing changes
        picture = self._edited(picture) + (self.photo - self._edited(self.scene))
        return exposure * np.maximum(picture, 0), exposure * level

    def _edited(self, picture: Float[ndarray, "h w 3"]) -> Float[ndarray, "h w 3"]:
        return self.edit.apply(torch.from_numpy(picture)).numpy()

    def shaded_by(
        self, light: EnvironmentMap
    ) -> tuple[Float[ndarray, "p q 3"], Float[ndarray, "p q 3"]]:
        """(S, g) of the module's text under a light, 0 where there is no surface."""
        return _images(self.person, light, self.specular_scale, grey=self.grey)

    def _behind(self, light: EnvironmentMap) -> Float[ndarray, "3"]:
        """How much brighter what lies behind becomes."""
        before, after = (upright_irradiance(each) for each in (self.found, light))
        if self.grey:
            before, after = luminance(before), luminance(after)
        return float32((after / before).expand(3).numpy())


def shared_light(one: EnvironmentMap, other: EnvironmentMap) -> float:
    """How much of two lights is the same, whatever their strengths: ``max(0, 1 - |p - q|_1)``.

    p and q are their luminances on 16 rows, each of sum 1; 0 where half of the light is elsewhere.
    """
    parts = [power / power.sum() for power in (coarse_power(light) for light in (one, other))]
    return max(0.0, 1.0 - float((parts[0] - parts[1]).abs().sum()))


def coarse_power(light: EnvironmentMap) -> Float[Tensor, " n"]:
    """``L dw`` in luminance on :data:`SHARED_ROWS` rows."""
    coarse = light.resize(SHARED_ROWS)
    return luminance(coarse.flat).double() * coarse.grid.solid_angles


def upright_irradiance(light: EnvironmentMap) -> Float[Tensor, "3"]:
    """Of vertical surfaces, in the mean over their azimuths: ``sum_w L(w) sin(zenith) dw / pi``."""
    across = light.grid.directions[:, [0, 2]].norm(dim=1)
    weight = across * light.grid.solid_angles / math.pi
    return weight @ light.flat.double()


def _images(
    person: PersonSurface,
    light: EnvironmentMap,
    specular_scale: float,
    *,
    grey: bool,
) -> tuple[Float[ndarray, "p q 3"], Float[ndarray, "p q 3"]]:
    """(S, g) of the module's text as pictures, 0 where there is no surface."""
    shading = person.shade(light, SKIN_SPECULAR)
    diffuse, specular = (
        float32(person.surface.image(each).numpy())
        for each in (shading.diffuse, specular_scale * shading.specular)
    )
    if grey:
        diffuse, specular = (
            np.repeat((x @ _LUMINANCE)[..., None], 3, 2) for x in (diffuse, specular)
        )
    return diffuse, specular


def _from_skin(
    bare: Float[ndarray, "p q"], covered: Float[ndarray, "p q"]
) -> Float[ndarray, "p q"]:
    """Weights to fill from: skin's shading goes on beyond its border before that of hair does."""
    return np.maximum(bare, HAIR_COUNTS * covered)


def _enlarged(
    picture: Float[ndarray, "p q c"], known: Float[ndarray, "p q"], size: tuple[int, int]
) -> Float[ndarray, "h w c"]:
    return _resized(filled(picture, known), size)


def _resized(picture: Float[ndarray, "p q c"], size: tuple[int, int]) -> Float[ndarray, "h w c"]:
    return cv2.resize(float32(picture), size[::-1], interpolation=cv2.INTER_LINEAR).reshape(
        *size, -1
    )


def portrait_of(
    photo: Photo,
    fit: FaceFit,
    reflection: FaceReflection,
    found: EnvironmentMap,
    *,
    face_px: int = FACE_PX,
    shell: bool = True,
    workers: int = 1,
    progress: Progress | None = None,
) -> Portrait:
    """A photograph of a fitted head under the light ``found``, in its colours and units.

    ``shell`` gives the head a :func:`~skylight.portrait._surface.hair_shell`; ``face_px`` and
    ``workers``: of :meth:`~skylight.portrait._surface.PersonSurface.of`.
    """
    hair = hair_of(photo.pixels, HeadModel.load(), fit)
    person = PersonSurface.of(
        fit,
        reflection.head_error,
        hair if shell else None,
        face_px=face_px,
        workers=workers,
        progress=progress,
    )
    regions = person.region_image()
    hairy = cv2.resize(hair, regions.shape[::-1], interpolation=cv2.INTER_AREA)
    matte = person_matte(
        photo.encoded,
        (regions >= 0) & (regions < HAIR),
        regions == BUST,
        hairy,
        person.face_px,
    )
    return Portrait.of(
        photo.pixels,
        person,
        found,
        reflection.specular_scale,
        hairy,
        matte,
        grey=photo.grey,
        edit=reflection.edit,
    )


def light_in_photo(estimate: FoundLight, light: EnvironmentMap | None = None) -> EnvironmentMap:
    """The light found (or one like it) in the colours and units of the (first) face's photograph.

    An estimate's map has the light's own colours; the photograph shows them times its white
    balance.
    """
    light = light or estimate.environment
    return EnvironmentMap(radiance=light.radiance * estimate.white_balance)
