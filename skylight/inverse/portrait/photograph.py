"""A photograph with its estimate, taken apart for other light."""

from dataclasses import dataclass

import cv2
from jaxtyping import Float
from torch import Tensor

from skylight.faces.fit import FaceFit
from skylight.faces.model import HeadModel
from skylight.faces.observe import hair_of
from skylight.faces.segmentation.person import person_matte
from skylight.imaging.photo import Photo
from skylight.inverse.portrait.relit import Portrait
from skylight.inverse.portrait.surface import BUST, FACE_PX, HAIR, PersonSurface
from skylight.inverse.result import Estimate
from skylight.sphere.envmap import EnvironmentMap
from skylight.transport.observation import Observation
from skylight.work.progress import Progress


@dataclass(frozen=True, kw_only=True)
class FaceReflection:
    """What an estimate tells of a face beside its light.

    ``gloss`` is that of :class:`~skylight.inverse.result.FaceLight`; by ``head_error``, pose and
    shape are off, as :func:`~skylight.faces.normal_errors.normal_turns` takes it.
    """

    gloss: float
    head_error: Float[Tensor, " d"] | None

    @staticmethod
    def of(estimate: Estimate, seen: Observation) -> "FaceReflection":
        """The (first) face's, which was ``seen``."""
        face, modes = estimate.faces[0], seen.normal_modes
        if face.turns is None or modes is None or modes.axes is None:
            return FaceReflection(gloss=face.gloss, head_error=None)
        return FaceReflection(gloss=face.gloss, head_error=modes.axes @ face.turns.to(modes.axes))


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

    ``shell`` gives the head a :func:`~skylight.inverse.portrait.hair.hair_shell`; ``face_px`` and
    ``workers``: of :meth:`~skylight.inverse.portrait.surface.PersonSurface.of`.

    Raises
    ------
    InputError
        None of the face's skin is seen.
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
    return Portrait.of(photo.pixels, person, found, reflection.gloss, hairy, matte, grey=photo.grey)


def light_in_photo(estimate: Estimate, light: EnvironmentMap | None = None) -> EnvironmentMap:
    """The light found (or one like it) in the colours and units of the (first) face's photograph.

    An estimate's map has the light's own colours; the photograph shows them times its white
    balance.
    """
    light = light or estimate.environment
    return EnvironmentMap(radiance=light.radiance * estimate.white_balance)
