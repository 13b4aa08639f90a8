"""A photograph of a person in another light.

The picture is multiplied by ``exp(G)``, and never divided by anything that it was not lit by: with
ln L the level of a light (:func:`~skylight.portrait._gain.level_of`) on the face, A the light found
and B the new one ::

    G = v(m + ln f + q bounded(C(ln L_B - ln L_A) + (1 - c) U - m)) + tint + s,

m being the mean of ``ln L_B - ln L_A`` over the face, f 1 or what keeps the skin's brightness, C
what continues a gain beyond the face
(:meth:`~skylight.portrait._gain.Surface.continued`), U what of A the picture does not show
(:class:`~skylight.portrait._gain.Unseen`), c what the two lights share, and q below 1 where there
are doubts. So where the light stays, the picture stays. ``tint`` is the change of the lights' mean
colour, one for all of the person, and of what its hollows send each other
(:mod:`skylight.portrait._bounce`), and s what skin gets as it changes
(:class:`~skylight.portrait._gain.SkinColour`). The bound and v leave white and black what they are
(:mod:`skylight.portrait._room`). A lamp behind the person adds an edge
(:mod:`skylight.portrait._edge`).

What lies behind gets one gain: the ratio of the lights' irradiances of vertical surfaces, in the
mean over all azimuths. Between the two the matte mixes: it is how much of a pixel's light is the
person's.

Of a light, S is the diffuse shading of the person with albedo 1, and g its specular reflection
(:class:`~skylight.portrait._surface.Shading`).

All of that is done to what the camera saw: an :class:`~skylight.imaging._edits.Edit` of the
picture is undone before and done after.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from skylight.errors import InputError
from skylight.estimation._kept import FaceReflection, FoundLight
from skylight.faces._background import drawn_parts
from skylight.faces._fit import FaceFit
from skylight.faces._model import HeadModel, Region
from skylight.faces._observe import SKIN_SPECULAR, hair_of
from skylight.faces._segmentation import person_matte
from skylight.imaging._edits import UNEDITED, Edit
from skylight.imaging._photo import Photo
from skylight.portrait._bounce import bounced, hollow_tint, hue_of
from skylight.portrait._edge import EdgeLight, Outline, known, told_apart
from skylight.portrait._gain import (
    EXACT,
    LUMINANCE_WEIGHTS,
    SHARP,
    SkinColour,
    Surface,
    Unseen,
    bounded,
    colour_of,
    float32,
    level_of,
    resized,
    soft_matte,
    unseen,
)
from skylight.portrait._room import (
    above_veil,
    base_of,
    below_white,
    headroom,
    light_share,
    veil_of,
    white_of,
)
from skylight.portrait._surface import (
    BUST,
    FACE_PX,
    HAIR,
    SKIN,
    LitPerson,
    PersonSurface,
    region_image,
)
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.transport._render import SMOOTH_HEIGHT
from skylight.work._progress import Progress

# Of what the skin shows in any channel. Estimates take too much for specular reflection, most of
# all of over-exposed skin; of the darkest skin a correct specular scale is cut too.
MOST_SPECULAR = 0.4
FRONT = (Region.FACE, Region.LIPS, Region.BROW, Region.SCALP)  # where the model fits
# Of the old picture: nothing more than is no light, the skin's brightness, or all of the place but
# where its light comes from.
Keep = Literal["nothing", "brightness", "place"]
WHITE, MANY_WHITE = 0.98, 0.1  # over-exposed, and how much of the skin may be
MORE_BEHIND = 6.0  # times the light that falls on the front of an upright surface
FLAT = 0.2  # standard deviation of logarithms: skin that shows no direction of its light
LITTLE = 0.3  # of the light's variation
_BLACKEST = 0.01  # albedo
_NO_STRAY = 1e-9
_DOUBTED = 0.7  # of the gain, for each doubt
SHARED_ROWS = 16  # cells of 11 degrees: how far a lamp moves until it is another one


@dataclass(frozen=True, kw_only=True)
class Gains:
    """What a picture is multiplied by, ``times`` (h,w,3), and how much of an ``edge`` (h,w,2) its
    surfaces and hair get as far as there is room below white, None where there is none, of a lamp
    of that ``colour`` (3,). ``factor`` is of the light, so that skin keeps its brightness.
    """

    times: Float[ndarray, "h w 3"]
    edge: Float[ndarray, "h w 2"] | None
    colour: Float[ndarray, "3"]
    factor: float


@dataclass(frozen=True, kw_only=True)
class Held:
    """What is the same in all frames of a film: of one picture each is found with some error,
    which would flicker. Names are those of :class:`Portrait`, :class:`Unseen` and
    :class:`SkinColour`."""

    specular_scale: float
    albedo: float
    slope: float
    lacks: Float[ndarray, "n 3"]
    lit: float
    veil: float
    doubts: tuple[str, ...]

    @staticmethod
    def of(portraits: Sequence["Portrait"]) -> "Held":
        """Medians of some frames."""
        by_doubts = sorted(portraits, key=lambda one: one.strength)
        return Held(
            specular_scale=float(np.median([one.specular_scale for one in portraits])),
            albedo=float(np.median([one.albedo for one in portraits])),
            slope=float(np.median([one.unseen.slope for one in portraits])),
            lacks=np.median([one.colour.lacks for one in portraits], axis=0),
            lit=float(np.median([one.lit for one in portraits])),
            veil=float(np.median([one.veil for one in portraits])),
            doubts=by_doubts[len(by_doubts) // 2].doubts,
        )


@dataclass(frozen=True, kw_only=True)
class Portrait:
    """A photograph taken apart, so that any light can be put in the place of ``found``.

    ``scene`` is the photograph before its ``edit``, ``matte`` (h,w) how much of a pixel's light is
    the person's. ``outline`` is what a lamp behind the person lights, and ``lit`` the luminance of
    what is white and lit as skin is in the mean. ``skin`` (h,w) is how much of it shows skin;
    ``base`` (h,w), ``veil`` and ``white`` are of :mod:`skylight.portrait._room`. At the pixels of
    ``person``, ``shading`` and ``specular`` (p,q,3) are S_A and g_A, and ``on`` says where they
    show skin. ``before`` is ln L_A, ``unseen`` U, ``colour`` gives s, and ``mean`` (3,) is the
    mean S_A of skin. ``openness`` (p,q) and ``hue`` (3,) are o and h of
    :mod:`skylight.portrait._bounce`, and ``hollow_share`` (p,q) is how much of A's light on the
    face comes from the face, continued beyond it. ``albedo`` is that of skin in luminance.
    ``specular_scale`` is at most that whose mean g_A over skin is :data:`MOST_SPECULAR` of the
    photograph's in each channel. ``strength`` is q, and ``doubts`` say why it is below 1.
    """

    photo: Float[ndarray, "h w 3"]
    edit: Edit
    scene: Float[ndarray, "h w 3"]
    person: LitPerson
    found: EnvironmentMap
    specular_scale: float
    grey: bool
    albedo: float
    matte: Float[ndarray, "h w"]
    outline: Outline
    lit: float
    base: Float[ndarray, "h w"]
    skin: Float[ndarray, "h w"]
    veil: float
    white: float
    shading: Float[ndarray, "p q 3"]
    specular: Float[ndarray, "p q 3"]
    on: Surface
    mean: Float[ndarray, "3"]
    openness: Float[ndarray, "p q"]
    hue: Float[ndarray, "3"]
    hollow_share: Float[ndarray, "p q"]
    before: Float[ndarray, "p q"]
    unseen: Unseen
    colour: SkinColour
    strength: float
    doubts: tuple[str, ...]

    @staticmethod
    def of(
        photo: Float[Tensor, "h w 3"],
        person: LitPerson,
        found: EnvironmentMap,
        specular_scale: float,
        hair: Float[ndarray, "p q"],
        matte: Float[ndarray, "h w"],
        *,
        grey: bool = False,
        edit: Edit = UNEDITED,
        white: float = 1.0,
        held: "Held | None" = None,
    ) -> "Portrait":
        """From a linear photograph, ``edit`` done to it, and the light ``found`` in its units.

        ``specular_scale`` is the strength of the skin's specular lobe; ``hair``
        is how likely a pixel of ``person`` shows hair; ``white`` what the photograph's codes end
        at. What is ``held``, over a film, is not found again; its specular scale counts.
        """
        picture = float32(edit.undo(photo).numpy())
        white = float(edit.undo(torch.full((3,), white))[0])
        if held is not None:
            specular_scale = held.specular_scale
        shading, specular = _images(person, found, specular_scale, grey=grey)
        small = cv2.resize(picture, shading.shape[1::-1], interpolation=cv2.INTER_AREA)
        regions = region_image(person)
        on_skin = np.isin(regions, SKIN) & (hair < 0.5)
        if not on_skin.any():
            raise InputError("the face is turned away or covered: no skin of it can be relit")
        front = on_skin & np.isin(regions, FRONT)
        on = Surface(
            bare=float32(on_skin),
            face=float32(front if front.any() else on_skin),
            traced=float32(np.isin(regions, SKIN)),
            face_px=person.face_px,
        )
        mean, shine, shown = (on.mean(each) for each in (shading, specular, small))
        most = 1.0
        if held is None:
            most = min(1.0, float((MOST_SPECULAR * shown / np.maximum(shine, 1e-12)).min()))
        specular = most * specular
        albedo = float(
            (shown - most * shine) @ LUMINANCE_WEIGHTS / max(mean @ LUMINANCE_WEIGHTS, 1e-12)
        )
        albedo = max(albedo, _BLACKEST) if held is None else held.albedo
        openness = _openness(person)
        hue = hue_of(colour_of(np.maximum(shown - most * shine, 0)) - colour_of(mean))
        hollow = bounced(shading @ LUMINANCE_WEIGHTS, openness, on.traced, on.face_px)
        before, exact = (
            level_of(shading, hollow, specular / albedo, on, x) for x in (SHARP, EXACT)
        )
        plain = on_skin & (regions == Region.FACE)
        plain = float32(plain) if plain.any() else on.face
        hidden = unseen(picture, before, exact, plain, on, None if held is None else held.slope)
        head = float32((regions >= 0) & (regions != BUST))
        doubts = _doubts(small[on_skin], found, hidden) if held is None else held.doubts
        head_drawn = (regions >= 0) & (regions < HAIR)
        face_px = person.face_px * len(picture) / len(regions)  # in the picture's pixels
        cut = soft_matte(picture, float32(matte), head, person.face_px)
        own = light_share(picture, cut, face_px)
        small_matte = cv2.resize(own, small.shape[1::-1], interpolation=cv2.INTER_AREA)
        near = known(head_drawn, hair, regions == BUST, small_matte, person.face_px)
        veil = veil_of(picture, white) if held is None else held.veil
        sure = told_apart(picture, float32(matte), face_px)
        small_cut = cv2.resize(cut, small.shape[1::-1], interpolation=cv2.INTER_AREA)
        base = base_of(picture, white, face_px)
        small_base = cv2.resize(base, small.shape[1::-1], interpolation=cv2.INTER_AREA)
        colour = SkinColour.of(small, small_base, plain, on, None if held is None else held.lacks)
        return Portrait(
            photo=float32(photo.numpy()),
            edit=edit,
            scene=picture,
            person=person,
            found=found,
            specular_scale=most * specular_scale,
            grey=grey,
            albedo=albedo,
            matte=own,
            outline=Outline.of(
                small, small_cut, small_matte, sure, near, colour.alike, hair, person.face_px
            ),
            lit=float(mean @ LUMINANCE_WEIGHTS) if held is None else held.lit,
            base=base,
            skin=resized(
                # wholly to its border: so the face's own is not bounded as hair is
                np.minimum(2 * cv2.GaussianBlur(on.bare, (0, 0), SHARP * on.face_px), 1),
                picture.shape[:2],
            ),
            veil=veil,
            white=white,
            shading=shading,
            specular=specular,
            on=on,
            mean=mean,
            openness=openness,
            hue=hue,
            hollow_share=on.continued(on.share_of(hollow, shading)),
            before=before,
            unseen=hidden,
            colour=colour,
            strength=_DOUBTED ** len(doubts),
            doubts=doubts,
        )

    def under(
        self,
        light: EnvironmentMap,
        exposure: float = 1.0,
        *,
        keep: Keep = "nothing",
        edge: EdgeLight | None = None,
    ) -> tuple[Float[ndarray, "h w 3"], float]:
        """The photograph in another light times an exposure, linear, and that exposure.

        ``keep``: "brightness" multiplies ``exposure`` by what leaves the mean shading of skin as
        bright as it was. "place", of the light found but moved: white is balanced so that skin
        keeps its mean colour, and what lies behind is not relit. Neither can be had of
        light that does not reach the skin, which is shown as it is. ``edge`` is a lamp behind the
        person, which lights the outline.
        """
        gains = self.gains(light, keep=keep, edge=edge, exposure=exposure)
        return exposure * self.changed(gains), exposure * gains.factor

    def gains(
        self,
        light: EnvironmentMap,
        *,
        keep: Keep = "nothing",
        edge: EdgeLight | None = None,
        factor: float | None = None,
        exposure: float = 1.0,
    ) -> Gains:
        """What :meth:`under` does to the picture, but for the ``exposure``, with which skin comes
        out of white too.

        ``factor`` is what keeps the skin's brightness, where that is known.
        """
        size = (self.scene.shape[0], self.scene.shape[1])
        shading, specular = self.shaded_by(light)
        received = self.on.mean(shading)
        hollow = self.bounced(shading)
        gain = level_of(shading, hollow, specular / self.albedo, self.on) - self.before
        cast = colour_of(received) - colour_of(self.mean)
        if factor is None:
            factor = 1.0
            if keep == "brightness" and received.any():
                factor = float(self.mean @ LUMINANCE_WEIGHTS / (received @ LUMINANCE_WEIGHTS))
        if keep == "place" and received.all():
            cast = np.zeros_like(cast)
        other = 1 - shared_light(self.found, light)
        typical = float(gain[self.on.face > 0].mean())
        gain = resized(self.on.continued(gain), size) + other * self.unseen.level - typical
        usual = typical + math.log(factor)
        most, least = headroom(self.base, usual, self.skin)
        level = self.strength * bounded(gain, most, least) + usual
        level = above_veil(level, self.base, self.skin, self.veil, usual)
        level = below_white(level, self.base, self.skin)
        tint = cast + self.skin[..., None] * resized(self._reddened(shading, hollow), size)
        tint = tint + self.colour.change(level - usual, self.base)
        tint = tint + self.colour.without_highlights(level - usual)
        tint = tint + self.colour.out_of_white(level + np.float32(math.log(max(exposure, 1e-9))))
        behind = np.ones(3, np.float32)
        if keep != "place":
            behind = np.maximum(factor * self._behind(light), 1e-9)
        within = self.matte[..., None]
        edged = None
        if edge is not None:
            # less where little is left to white; what passes it all the same is rolled off
            room = np.maximum(1 - np.exp(self.base + level), 0)
            edged = (room * self.matte)[..., None] * self.outline.lit(edge)
        return Gains(
            times=within * np.exp(tint + level[..., None]) + (1 - within) * behind,
            edge=edged,
            colour=np.array((1, 1, 1) if edge is None or self.grey else edge.colour, np.float32),
            factor=factor,
        )

    def changed(self, gains: Gains) -> Float[ndarray, "h w 3"]:
        """The photograph with those gains, linear."""
        picture = self.scene * gains.times
        if gains.edge is not None:
            picture = picture + self.outline.sent(
                self.scene, gains.edge, gains.colour, self.lit, self.stray
            )
        # what an edit made black is not known again: where nothing changed, nothing changes
        picture = self._edited(picture) + (self.photo - self._edited(self.scene))
        return np.maximum(picture, 0)

    @property
    def stray(self) -> float:
        """The veil's luminance, in the picture's unit; above 0."""
        return max(self.veil * self.white, _NO_STRAY)

    def _edited(self, picture: Float[ndarray, "h w 3"]) -> Float[ndarray, "h w 3"]:
        return self.edit.apply(torch.from_numpy(picture)).numpy()

    def shaded_by(
        self, light: EnvironmentMap
    ) -> tuple[Float[ndarray, "p q 3"], Float[ndarray, "p q 3"]]:
        """(S, g) of the module's text under a light, 0 where there is no skin."""
        return _images(self.person, light, self.specular_scale, grey=self.grey)

    def bounced(self, shading: Float[ndarray, "p q 3"]) -> Float[ndarray, "p q"]:
        """B of :mod:`skylight.portrait._bounce`."""
        direct = shading @ LUMINANCE_WEIGHTS
        return bounced(direct, self.openness, self.on.traced, self.on.face_px)

    def _reddened(
        self, shading: Float[ndarray, "p q 3"], hollow: Float[ndarray, "p q"]
    ) -> Float[ndarray, "p q 3"]:
        """What hollows change of their colour, as far as the gain is laid on."""
        share = self.on.continued(self.on.share_of(hollow, shading))
        after, before = (hollow_tint(each, self.hue) for each in (share, self.hollow_share))
        return self.strength * (after - before)

    def _behind(self, light: EnvironmentMap) -> Float[ndarray, "3"]:
        """How much brighter what lies behind becomes."""
        before, after = (upright_irradiance(each) for each in (self.found, light))
        if self.grey:
            before, after = luminance(before), luminance(after)
        return float32((after / before).expand(3).numpy())


def _doubts(skin: Float[ndarray, "n 3"], found: EnvironmentMap, hidden: Unseen) -> tuple[str, ...]:
    """Why new light is laid on weaker: each a line to be read."""
    white = float((skin.max(1) >= WHITE).mean())
    front, back = (
        float(luminance(found.irradiance(torch.tensor([0.0, 0.0, z])))) for z in (1.0, -1.0)
    )
    doubts: list[str] = []
    if white > MANY_WHITE:
        doubts.append(
            f"{100 * white:.0f} % of the skin is over-exposed and has no shape to relight"
        )
    if back > MORE_BEHIND * front:
        doubts.append("the photograph's light is from behind: of the face it tells little")
    if hidden.slope < LITTLE and hidden.contrast > FLAT:
        doubts.append("the shadows on the face are not those of the light found, so they stay")
    return tuple(f"{doubt}; the new light is weaker" for doubt in doubts)


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


def _openness(person: LitPerson) -> Float[ndarray, "p q"]:
    """How much of an even light reaches each point of skin, 0 elsewhere."""
    even = EnvironmentMap(radiance=torch.ones(SMOOTH_HEIGHT, 2 * SMOOTH_HEIGHT, 3))
    received = person.shade(even, None).diffuse[:, :1]
    return float32(person.surface.image(received).numpy())[..., 0]


def _images(
    person: LitPerson,
    light: EnvironmentMap,
    specular_scale: float,
    *,
    grey: bool,
) -> tuple[Float[ndarray, "p q 3"], Float[ndarray, "p q 3"]]:
    """(S, g) of the module's text as pictures, 0 where there is no skin."""
    shading = person.shade(light, SKIN_SPECULAR)
    diffuse, specular = (
        float32(person.surface.image(each).numpy())
        for each in (shading.diffuse, specular_scale * shading.specular)
    )
    if grey:
        diffuse, specular = (
            np.repeat((x @ LUMINANCE_WEIGHTS)[..., None], 3, 2) for x in (diffuse, specular)
        )
    return diffuse, specular


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
    hairy, matte = cut_out(photo, person, hair)
    return Portrait.of(
        photo.pixels,
        person,
        found,
        reflection.specular_scale,
        hairy,
        matte,
        grey=photo.grey,
        edit=reflection.edit,
        white=white_of(photo),
    )


def cut_out(
    photo: Photo,
    person: LitPerson,
    hair: Float[ndarray, "h w"],
    before: Float[ndarray, "h w"] | None = None,
) -> tuple[Float[ndarray, "p q"], Float[ndarray, "h w"]]:
    """(how likely a pixel of ``person`` shows hair, the person's matte in the photograph).

    ``before`` is of :func:`~skylight.faces._segmentation.person_matte`.
    """
    regions = region_image(person)
    hairy = cv2.resize(hair, regions.shape[::-1], interpolation=cv2.INTER_AREA)
    matte = person_matte(
        photo.encoded,
        (regions >= 0) & (regions < HAIR),
        regions == BUST,
        hairy,
        person.face_px,
        before,
    )
    head = cv2.resize(float32(regions >= 0), matte.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return hairy, matte * (1 - drawn_parts(photo.encoded, np.maximum(matte, head)))


def light_in_photo(estimate: FoundLight, light: EnvironmentMap | None = None) -> EnvironmentMap:
    """The light found (or one like it) in the colours and units of the (first) face's photograph.

    An estimate's map has the light's own colours; the photograph shows them times its white
    balance.
    """
    light = light or estimate.environment
    return EnvironmentMap(radiance=light.radiance * estimate.white_balance)
