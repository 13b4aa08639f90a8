"""A photograph with its estimate, taken apart for other light."""

import cv2

from skylight.faces.fit import FaceFit
from skylight.faces.model import HeadModel
from skylight.faces.observe import hair_of
from skylight.faces.segmentation.person import person_matte
from skylight.imaging.photo import Photo
from skylight.inverse.portrait.relit import Portrait
from skylight.inverse.portrait.surface import BUST, FACE_PX, PersonSurface
from skylight.inverse.result import Estimate
from skylight.sphere.envmap import EnvironmentMap
from skylight.work.progress import Progress


def portrait_of(
    photo: Photo,
    fit: FaceFit,
    estimate: Estimate,
    *,
    face_px: int = FACE_PX,
    workers: int = 1,
    progress: Progress | None = None,
) -> Portrait:
    """The person of the estimate's (first) face, whose head is ``fit``, in its photograph.

    ``face_px`` and ``workers``: of :meth:`~skylight.inverse.portrait.surface.PersonSurface.of`.

    Raises
    ------
    InputError
        None of the face's skin is seen.
    """
    face = estimate.faces[0]
    person = PersonSurface.of(fit, face.turns, face_px=face_px, workers=workers, progress=progress)
    hair = hair_of(photo.pixels, HeadModel.load(), fit)
    regions = person.region_image()
    matte = person_matte(
        photo.encoded,
        (regions >= 0) & (regions != BUST),
        regions == BUST,
        cv2.resize(hair, regions.shape[::-1], interpolation=cv2.INTER_AREA),
        person.face_px,
    )
    return Portrait.of(
        photo.pixels,
        person,
        light_in_photo(estimate),
        face.gloss,
        hair,
        matte,
        grey=photo.grey,
    )


def light_in_photo(estimate: Estimate, light: EnvironmentMap | None = None) -> EnvironmentMap:
    """The light found (or one like it) in the colours and units of the (first) face's photograph.

    An estimate's map has the light's own colours, of which the photograph shows gains.
    """
    face = estimate.faces[0]
    gains = face.white_balance * (face.exposure / estimate.exposure)
    light = light or estimate.environment
    return EnvironmentMap(radiance=light.radiance * gains)
