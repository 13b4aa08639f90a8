"""The objective of inverse lighting (thesis, Eq. 5.8) as a function of free parameters.

One light, seen on one face or more: every face adds its own data term and priors. Problems of one
shape (as many faces in the same photographs, all with specular reflection or none) share one
objective, so that points of all of them are evaluated as one batch.
"""

from collections.abc import Callable, Collection, Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import pad

from skylight.faces._skin import PIGMENT_COLOURS, PIGMENT_SPREADS
from skylight.imaging._edits import edited
from skylight.inverse._background import ROW_WEIGHT
from skylight.inverse._faces import FaceTerm, ObjectiveWeights, Transported, Unpacked, of_problem
from skylight.inverse._gauss_newton import charbonnier
from skylight.inverse._scale import (
    SCALES,
    SPECULAR_SPREAD,
    bayes_scale,
    scale_nll,
    specular_nll,
    tone_prior,
)
from skylight.inverse._sun_prior import SunPrior
from skylight.models._base import CurvedPrior, LightModel, Prior, without_azimuth
from skylight.models._ground import GroundBelow, KnownGround, LambertianGround, ground_prior
from skylight.models._lobes import LampedLight
from skylight.models._prior import GaussianMixture, convex, convex_shape
from skylight.transport._reflection import shade_scenes

# A free parameter of 1 is so many standard deviations of a turn: without, a turn's slope is so much
# less than those of light and exposure that quasi-Newton steps do not reach it.
TURN_STEP = 10.0
MOST_EDIT = 2.0  # of log saturation and log contrast: a line search may try anything
# Quadratic in free parameters: -log of normal densities about 0
NORMAL_PRIORS = (
    "gloss_prior",
    "white_balance_prior",
    "edit_prior",
    "pigment_prior",
    "normal_prior",
)


class LightObjective:
    """Eq. 5.8 for a model of the sky over a Lambertian ground, summed over the faces it lights.

    Beyond the thesis, a share of surface reflection: shading is rho T l + specular_scale G l, with
    one unknown strength for each face (1 is what the index of refraction of skin says). On dark
    skin highlights are as bright as the diffuse part, and taken for diffuse they pull the sun
    aside.

    Beyond it too, every photograph has gains of its channels, diag(g) (rho T l + specular_scale
    G l) with sum_c log g_c = 0, which are what its camera's white balance is wrong by. Cameras take
    away part of what colours the light: without gains a low sun has to be warm, so skin turns blue.

    What its camera's style or an editor did then, saturation and contrast about the mean level of
    its faces (:mod:`skylight.imaging._edits`), is unknown too: where it is not, a saturated picture
    has skin that nobody has, under light of the complementary colour.

    And the albedo of a face varies with its melanin and blood, as smooth fields that
    :mod:`skylight.faces._skin` has: rho of pixel p is a prod_i exp(-d_i sum_k Phi_pk u_ik), with
    u_ik normal. Of one albedo, redder cheeks and a darker jaw would be shading.

    And the head is not known: its normals may be turned along the modes that
    :mod:`skylight.faces._normal_errors` has, by normal amounts. Trusted, flat cheeks of a fitted
    head turn the sun, and more than one direction looks certain.

    And where a photograph shows more than people, what stands behind them is a view of the light
    itself: :mod:`skylight.inverse._background`.

    Without a ``light_prior`` all lights of the model are alike. ``albedo_prior`` is a density over
    *log* albedo: over albedo itself it would be the same distribution, but its maximum would lean
    towards dark skin.

    Free parameters of one problem: those of the light model, for each photograph a log exposure,
    its two log gains against green, log saturation and log contrast, for each face the log specular
    scale, the logits of skin albedo, its turns and its pigments, then the logits of ground albedo,
    so that 0 < albedo < 1 always holds. A model of the whole sphere has no ground: where that is
    known, its lower half is likelier as bright as that (:class:`GroundBelow`). Targets are
    scaled beforehand to a mean luminance of 1 in each photograph, which makes the loss's epsilon
    mean the same for every picture, and 1 the pivot of contrast.
    """

    def __init__(
        self,
        faces: Sequence[FaceTerm],
        model: LightModel,
        light_prior: Prior | None,
        albedo_prior: GaussianMixture,
        weights: ObjectiveWeights,
        sun_priors: Sequence[SunPrior | None] = (),
        known_ground: KnownGround | None = None,
    ) -> None:
        self.faces = tuple(faces)
        self.sun_priors = tuple(sun_priors)
        self.photo_count = 1 + max(face.photo for face in faces)
        # once a photograph, whatever the number of its faces
        self.backgrounds = {
            face.photo: face.background
            for face in reversed(self.faces)
            if face.background is not None and weights.background > 0
        }
        self.model = model
        self.light_prior = light_prior
        self.albedo_prior = albedo_prior
        self.tone_prior = tone_prior(albedo_prior)
        self.weights = weights
        counts = {face.modes.shape[-1] for face in faces if face.modes is not None}
        self.mode_count = max(counts, default=0) if weights.pigment_spread > 0 else 0
        turned = {face.normals.modes.shape[-1] for face in faces if face.normals is not None}
        self.turn_count = max(turned, default=0) if weights.normal_spread > 0 else 0
        device = self.faces[0].target.device
        self.ground: LambertianGround | None = None
        if not model.grid.is_sphere:
            self.ground = LambertianGround(model.grid.layout[0]).to(device)  # type: ignore[index]
        self.known_ground = known_ground
        self.below: GroundBelow | None = None
        if known_ground is not None and model.grid.is_sphere:
            self.below = GroundBelow(known_ground).to(device)
            self.broad = model.on_rows(self.below.HEIGHT)
        self.ground_prior = ground_prior(known_ground).to(device)
        grey = [any(self.faces[k].grey for k in self.faces_of(n)) for n in range(self.photo_count)]
        s, k = weights.saturation_spread > 0, weights.contrast_spread > 0
        self.edits_counted = torch.tensor([[s and not one, k] for one in grey]).to(device)
        self.pigment_colours = torch.tensor(PIGMENT_COLOURS).to(self.faces[0].target)
        spreads = weights.pigment_spread * torch.tensor(PIGMENT_SPREADS)
        self.pigment_spreads = spreads.to(self.faces[0].target)[:, None]

    @property
    def size(self) -> int:
        return sum(self.sizes)

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Of the light, the photographs, the faces and the ground."""
        per_face = 4 + self.turn_count + 2 * self.mode_count
        faces, photos = per_face * len(self.faces), 5 * self.photo_count
        return self.model.parameter_count, photos, faces, 0 if self.ground is None else 3

    def faces_of(self, photo: int) -> list[int]:
        """Which faces are of that photograph."""
        return [k for k, face in enumerate(self.faces) if face.photo == photo]

    def pack(
        self,
        light: Float[Tensor, "b p"],
        exposure: Float[Tensor, "b n"],
        specular_scale: Float[Tensor, "b f"],
        albedo: Float[Tensor, "b f 3"],
        ground_albedo: Float[Tensor, "b g"],
        balance: Float[Tensor, "b n 2"] | None = None,
        pigments: Float[Tensor, "b f 2 k"] | None = None,
        turns: Float[Tensor, "b f j"] | None = None,
        edits: Float[Tensor, "b n 2"] | None = None,
    ) -> Float[Tensor, "b q"]:
        """Free parameters of physical ones.

        By default without a cast or an edit, of even skin, and of the normals that were fitted.
        """
        if balance is None:
            balance = exposure.new_zeros(*exposure.shape, 2)
        if pigments is None:
            pigments = specular_scale.new_zeros(*specular_scale.shape, 2, self.mode_count)
        if turns is None:
            turns = specular_scale.new_zeros(*specular_scale.shape, self.turn_count)
        if edits is None:
            edits = exposure.new_zeros(*exposure.shape, 2)
        camera = torch.cat([exposure.log()[..., None], balance, edits], 2)
        skin = torch.cat(
            [
                specular_scale.log()[..., None],
                torch.logit(albedo, eps=1e-4),
                turns / TURN_STEP,
                pigments.flatten(2),
            ],
            2,
        )
        return torch.cat(
            [
                self.model.to_free(light),
                camera.flatten(1),
                skin.flatten(1),
                torch.logit(ground_albedo, eps=1e-4),
            ],
            1,
        )

    def uneven(self, free: Float[Tensor, "b _"]) -> Float[Tensor, "b q"]:
        """Free parameters as they are, or of the same objective with even skin: without pigments.

        Both mean the same.
        """
        missing = (self.size - free.shape[1]) // len(self.faces)
        light, photos, faces, ground = self.sizes
        even = faces - missing * len(self.faces)
        parts = free.split((light, photos, even, ground), 1)
        skin = pad(parts[2].unflatten(1, (len(self.faces), -1)), (0, missing)).flatten(1)
        return torch.cat([*parts[:2], skin, parts[3]], 1)

    def unpack(self, free: Float[Tensor, "b q"]) -> Unpacked:
        light, camera, skin, ground_albedo = free.split(self.sizes, 1)
        camera = camera.unflatten(1, (-1, 5))
        skin = skin.unflatten(1, (len(self.faces), -1))
        return Unpacked(
            light=self.model.from_free(light),
            # beyond e^+-20 a line search has gone astray; exp must not overflow on its way back
            exposure=camera[..., 0].clamp(-20, 20).exp(),
            balance=camera[..., 1:3],
            edits=camera[..., 3:],
            specular_scale=skin[..., 0].clamp(-20, 5).exp(),
            albedo=torch.sigmoid(skin[..., 1:4]),
            ground_albedo=torch.sigmoid(ground_albedo),
            turns=TURN_STEP * skin[..., 4 : 4 + self.turn_count],
            pigments=skin[..., 4 + self.turn_count :].unflatten(2, (2, self.mode_count)),
        )

    def white_balance(self, parts: Unpacked) -> Float[Tensor, "b n 3"]:
        """The gains of each photograph's channels; their product is 1."""
        if self.weights.white_balance_spread == 0:
            return torch.ones_like(parts.albedo[:, :1]).expand(-1, self.photo_count, -1)
        log_gains = pad(parts.balance.clamp(-5, 5), (0, 1))[..., [0, 2, 1]]  # green in the middle
        return (log_gains - log_gains.mean(2, keepdim=True)).exp()

    def albedo(
        self, parts: Unpacked, k: int, problem: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, "b m 3"]:
        """That of face ``k`` at each pixel."""
        even, modes = parts.albedo[:, k, None], self.faces[k].modes
        if modes is None or self.mode_count == 0:
            return even.expand(-1, self.faces[k].target.shape[1], -1)
        amounts = shade_scenes(modes, parts.pigments[:, k].transpose(1, 2), problem)
        return even * torch.exp(-(amounts.clamp(-5, 5) @ self.pigment_colours))

    def shading(
        self,
        parts: Unpacked,
        problem: Int[Tensor, " b"] | None = None,
        light: tuple[Float[Tensor, "b n 3"], Float[Tensor, "b 3"]] | None = None,
    ) -> list[Float[Tensor, "b _ 3"]]:
        """Each face's rho T l + specular_scale G l times its photograph's exposure and gains.

        Where its normals may be wrong, T l has what they add, and is 0 where that is less.
        ``light`` is the :meth:`radiance` of the parts where that is known.
        """
        sky, ground = self.radiance(parts) if light is None else light
        return [
            self.reflected(
                parts, k, face.transported(sky, ground, self.turns(parts, k), problem), problem
            )
            for k, face in enumerate(self.faces)
        ]

    def radiance(self, parts: Unpacked) -> tuple[Float[Tensor, "b n 3"], Float[Tensor, "b 3"]]:
        """Of the sky, or of the whole sphere, and of the ground, for an exposure of 1."""
        sky = self.model(parts.light)
        return sky, self.ground_radiance(sky, parts.ground_albedo)

    def turns(self, parts: Unpacked, k: int) -> Float[Tensor, "b j"] | None:
        """What face ``k`` is turned by along its modes; None where normals are trusted."""
        return self.weights.normal_spread * parts.turns[:, k] if self.turn_count else None

    def reflected(
        self,
        parts: Unpacked,
        k: int,
        light: Transported,
        problem: Int[Tensor, " b"] | None = None,
    ) -> Float[Tensor, "b m 3"]:
        """What the picture shows of face ``k`` in that light."""
        shaded = self.shaded(parts, k, light, problem)
        return self.camera_response(parts, self.faces[k].photo, shaded)

    def shaded(
        self,
        parts: Unpacked,
        k: int,
        light: Transported,
        problem: Int[Tensor, " b"] | None = None,
    ) -> Float[Tensor, "b m 3"]:
        """The same for an exposure of 1, before the camera."""
        shading = self.albedo(parts, k, problem) * light.diffuse_shading
        if light.specular is not None:
            shading = shading + parts.specular_scale[:, k, None, None] * light.specular
        return shading

    def camera_response(
        self, parts: Unpacked, photo: int, radiance: Float[Tensor, "*s b m 3"]
    ) -> Float[Tensor, "*s b m 3"]:
        """What photograph ``photo`` shows of radiance: exposed, with its gains and edits."""
        gains = parts.exposure[:, photo, None] * self.white_balance(parts)[:, photo]
        picture, w = gains[:, None] * radiance, self.weights
        if w.saturation_spread == w.contrast_spread == 0:
            return picture
        return edited(picture, *self.edits(parts)[:, photo].unbind(1))

    def behind(
        self, parts: Unpacked, light: tuple[Float[Tensor, "b n 3"], Float[Tensor, "b 3"]]
    ) -> dict[int, Float[Tensor, "b _"]]:
        """The deviations of each photograph's background, in that light."""
        return {
            photo: term.deviation(self.camera_response(parts, photo, term.seen(*light)))
            for photo, term in self.backgrounds.items()
        }

    def edits(self, parts: Unpacked) -> Float[Tensor, "b n 2"]:
        """Saturation and contrast of each photograph; a grey one has no saturation to change."""
        return (parts.edits.clamp(-MOST_EDIT, MOST_EDIT) * self.edits_counted).exp()

    def ground_radiance(
        self, sky: Float[Tensor, "b n 3"], albedo: Float[Tensor, "b g"]
    ) -> Float[Tensor, "b 3"]:
        """What the ground reflects of the sky; 0 where the model has all that is below."""
        return sky.new_zeros(len(sky), 3) if self.ground is None else self.ground(sky, albedo)

    def terms(
        self, free: Float[Tensor, "b q"], problem: Int[Tensor, " b"] | None = None
    ) -> dict[str, Float[Tensor, " b"]]:
        """Each part of the objective, weighted and summed over faces; they add up to it."""
        parts, w = self.unpack(free), self.weights
        light = self.radiance(parts)
        shadings = self.shading(parts, problem, light)
        data = [f.data_term(s, w, problem) for f, s in zip(self.faces, shadings, strict=True)]
        terms = {"data": torch.stack(data).sum(0)}
        if self.backgrounds:
            terms["background"] = self.background_nll(self.behind(parts, light))
        return {**terms, **self.priors(free, problem)}

    def background_nll(self, behind: dict[int, Float[Tensor, "b _"]]) -> Float[Tensor, " b"]:
        """How unlikely the backgrounds are, of whose rows there is one photograph's at least."""
        each = [self.backgrounds[photo].cost(rows) for photo, rows in behind.items()]
        return self.weights.background * torch.stack(each).sum(0)

    def priors(
        self,
        free: Float[Tensor, "b q"],
        problem: Int[Tensor, " b"] | None = None,
        *,
        without: Collection[str] = (),
    ) -> dict[str, Float[Tensor, " b"]]:
        """All parts but the data and the background, and those ``without`` which."""
        parts, w = self.unpack(free), self.weights

        def albedo() -> Tensor:
            nll = -self.albedo_prior.log_prob(parts.albedo.log().flatten(0, 1))
            return w.albedo_prior * nll.unflatten(0, (-1, len(self.faces))).sum(1)

        every: dict[str, Callable[[], Tensor | None]] = {
            "light_prior": lambda: self._light_nll(free[:, : self.model.parameter_count]),
            "albedo_prior": albedo,
            "ground_prior": lambda: self._ground_nll(parts),
            "gloss_prior": lambda: (
                0.5 * (parts.specular_scale.log() / SPECULAR_SPREAD).square().sum(1)
            ),
            "white_balance_prior": lambda: self._white_balance_nll(parts),
            "edit_prior": lambda: self._edit_nll(parts),
            "pigment_prior": lambda: (
                0.5 * (parts.pigments / self.pigment_spreads).square().sum((1, 2, 3))
            ),
            "normal_prior": lambda: 0.5 * parts.turns.square().sum((1, 2)),
            "sun_prior": lambda: self.sun_nll(parts.light, problem),
        }
        terms = {name: nll() for name, nll in every.items() if name not in without}
        return {name: nll for name, nll in terms.items() if nll is not None}

    def prior(
        self,
        free: Float[Tensor, "b q"],
        problem: Int[Tensor, " b"] | None = None,
        *,
        without: Collection[str] = (),
    ) -> Float[Tensor, " b"]:
        """The sum of :meth:`priors`."""
        return torch.stack(list(self.priors(free, problem, without=without).values())).sum(0)

    def prior_shape(
        self,
        free: Float[Tensor, "b q"],
        problem: Int[Tensor, " b"] | None = None,
        *,
        clock: bool = True,
    ) -> tuple[Float[Tensor, "b q"], Float[Tensor, "b q q"]]:
        """Slope of the :meth:`prior`, and its Hessian without negative eigenvalues.

        A light prior may offer its own; normal ones and that of albedo are known, the others are
        by differences. Without a ``clock``, that says nothing.
        """
        model, own, w = self.model, self.light_prior, self.weights
        without = [*NORMAL_PRIORS, "albedo_prior", *([] if clock else ["sun_prior"])]
        unknowns = torch.arange(self.size, device=free.device)
        light, _, skin, ground = unknowns.split(self.sizes)
        precisions = self._normal_precisions().to(free)
        slope, hessian = free * precisions, torch.diag(precisions).repeat(len(free), 1, 1)

        def add(columns: Tensor, first: Tensor, second: Tensor) -> None:
            slope[:, columns] += first
            hessian[:, columns[:, None], columns] += second

        for of_face in skin.unflatten(0, (len(self.faces), -1))[:, 1:4]:
            albedo = torch.sigmoid(free[:, of_face])
            first, second = self.albedo_prior.shape(albedo.log())  # d log a = (1 - a) d logit
            along = 1 - albedo
            second = along[:, :, None] * second * along[:, None]
            second = convex(second - torch.diag_embed(first * albedo * along))
            add(of_face, w.albedo_prior * first * along, w.albedo_prior * second)
        if isinstance(own, CurvedPrior):
            without.append("light_prior")
            first, second = own.convex_shape(without_azimuth(model, free[:, : len(light)]))
            add(without_azimuth(model, light), w.light_prior * first, w.light_prior * second)
        left = self.priors(free, problem, without=without).keys()
        if left:
            if self.below is None and "light_prior" not in left:
                light = light[self._of_suns()] if "sun_prior" in left else light[:0]
            bent = torch.cat([light, ground])

            def others(x: Tensor, rows: Tensor) -> Tensor:
                whole = free[rows].index_copy(1, bent, x)
                mine = None if problem is None else problem[rows]
                return self.prior(whole, mine, without=without)

            every = torch.arange(len(free), device=free.device)
            add(bent, *convex_shape(others, free[:, bent], every))
        return slope, hessian

    def _of_suns(self) -> slice | list[int]:
        """Which of the light's unknowns say where the sun stands."""
        if not isinstance(self.model, LampedLight):
            return slice(None)
        at, turn = self.model.ambient_parameters, self.model.azimuth_index
        lamps = range(at, self.model.parameter_count)
        return [*([] if turn is None else [turn]), *lamps]

    def _normal_precisions(self) -> Float[Tensor, " q"]:
        """Those of the :data:`NORMAL_PRIORS`, all about 0; of other unknowns 0."""
        w, zero = self.weights, torch.zeros(1, dtype=torch.float64)
        spreads = [w.white_balance_spread] * 2 + [w.saturation_spread, w.contrast_spread]
        camera = torch.cat([zero, zero.new_tensor([spread or 1.0 for spread in spreads]) ** -2])
        skin = [
            zero + SPECULAR_SPREAD**-2,
            zero.expand(3),
            zero.new_full((self.turn_count,), TURN_STEP**2),
            (self.pigment_spreads.cpu() ** -2).expand(2, self.mode_count).flatten(),
        ]
        light, _, _, ground = self.sizes
        faces = torch.cat(skin).repeat(len(self.faces))
        of_all = [zero.expand(light), camera.repeat(self.photo_count), faces, zero.expand(ground)]
        return torch.cat(of_all)

    def deviation_weights(
        self, off: Float[Tensor, "b _"], problem: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, "b m"]:
        """What the Charbonnier of each pixel and channel of all faces counts, nats.

        Of concave costs, where faces are ``off`` by that much: the tangent, which lies above.
        """
        each = torch.cat(self._shares(problem), 1) * (self.weights.independent / self.weights.noise)
        return each / self.of_pixels(self.scale_of_noise(off, problem), problem)

    def scale_of_noise(
        self, off: Float[Tensor, "b _"], problem: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, "b f"]:
        """By how much more than expected each face deviates; 1 where that is known beforehand."""
        if not self.weights.noise_of_face:
            return off.new_ones(len(off), len(self.faces))
        shares = self._shares(problem)
        of_faces = off.split([share.shape[1] for share in shares], 1)
        each = zip(of_faces, shares, strict=True)
        means = torch.stack([(charbonnier(r) * share).sum(1) for r, share in each], 1)
        return (means / self.weights.noise).clamp(min=1)

    def of_pixels(
        self, of_faces: Float[Tensor, "b f"], problem: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, "b m"]:
        """What each face has, for each of its pixels and channels."""
        each = zip(of_faces.unbind(1), self._shares(problem), strict=True)
        return torch.cat([one[:, None].expand(-1, share.shape[1]) for one, share in each], 1)

    def _shares(self, problem: Int[Tensor, " b"] | None) -> list[Float[Tensor, "#b _"]]:
        """The weight of each face's pixels and channels."""
        shares = [of_problem(face.share, problem).expand(-1, -1, 3) for face in self.faces]
        return [share.flatten(1) for share in shares]

    def background_weights(self, behind: dict[int, Float[Tensor, "b _"]]) -> Float[Tensor, "b _"]:
        """What the Charbonnier of each of the rows :meth:`behind` counts, nats: the tangent of its
        concave cost, which lies above it."""
        each = [
            self.backgrounds[photo].trust(rows)[:, None].expand_as(rows)
            for photo, rows in behind.items()
        ]
        return self.weights.background * ROW_WEIGHT * torch.cat(each, 1)

    def sun_nll(
        self, light: Float[Tensor, "b p"], problem: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, " b"] | None:
        """How unlikely the sun's direction is by clock and place, in nats, weighted.

        Of lamps one is the sun, each alike. None where clock and place tell no problem of it, or
        the model has no sun.
        """
        suns = self.suns(light) if any(self.sun_priors) else None
        if suns is None:
            return None
        nll = light.new_zeros(len(light))
        for number, prior in enumerate(self.sun_priors):
            if prior is not None:
                own = -self.weights.sun_prior * prior.of_one(suns)
                nll = own if problem is None else torch.where(problem == number, own, nll)
        return nll

    def suns(self, light: Float[Tensor, "b p"]) -> Float[Tensor, "b k 3"] | None:
        """Where the sun stands: in one direction, or in one of those of the lamps."""
        if isinstance(self.model, LampedLight):
            return self.model.lamps(light).directions if self.model.count else None
        sun = self.model.sun_direction(light)
        return None if sun is None else sun[..., None, :]

    def _light_nll(self, free: Float[Tensor, "b p"]) -> Float[Tensor, " b"] | None:
        if self.light_prior is None:
            return None
        nll = -self.light_prior.log_prob(without_azimuth(self.model, free)).to(free.dtype)
        return self.weights.light_prior * nll

    def _ground_nll(self, parts: Unpacked) -> Float[Tensor, " b"] | None:
        if self.below is not None:
            nll = -self.below.log_prob(self.broad(parts.light))
        elif self.ground is not None:
            nll = -self.ground_prior.log_prob(parts.ground_albedo.log())
        else:
            return None
        return self.weights.ground_prior * nll

    def _white_balance_nll(self, parts: Unpacked) -> Float[Tensor, " b"]:
        spread = self.weights.white_balance_spread or 1.0  # of gains that do not count
        return 0.5 * (parts.balance / spread).square().sum((1, 2))

    def _edit_nll(self, parts: Unpacked) -> Float[Tensor, " b"]:
        w = self.weights
        spreads = parts.edits.new_tensor([w.saturation_spread or 1.0, w.contrast_spread or 1.0])
        return 0.5 * (parts.edits / spreads).square().sum((1, 2))

    @torch.no_grad()
    def at_bayes_scale(self, free: Float[Tensor, "b q"]) -> Float[Tensor, "b q"]:
        """The same appearance with albedo and exposure at the scale of least expected error.

        Albedo and specular scale times c under 1/c of a photograph's exposure look the same: only
        the priors know c, and between skins of different tone they have valleys that a descent does
        not cross. Every photograph's c is that of :func:`bayes_scale`, by what its background
        tells of it too.
        """
        parts = self.unpack(free)
        exposure, specular_scale, albedo = (
            parts.exposure.clone(),
            parts.specular_scale.clone(),
            parts.albedo.clone(),
        )
        light = self.radiance(parts) if self.backgrounds else None
        for photo in range(self.photo_count):
            mine = self.faces_of(photo)
            has_specular = free.new_tensor([self.faces[k].specular is not None for k in mine])
            nll = scale_nll(albedo[:, mine], self.tone_prior, self.weights.albedo_prior)
            nll = nll + specular_nll(specular_scale[:, mine], has_specular)
            if light is not None and photo in self.backgrounds:
                nll = nll + self._scales_behind(parts, photo, light)
            scale = bayes_scale(nll)
            exposure[:, photo] /= scale
            specular_scale[:, mine] *= scale[:, None]
            albedo[:, mine] *= scale[:, None, None]
        return self.pack(
            parts.light,
            exposure,
            specular_scale,
            albedo,
            parts.ground_albedo,
            parts.balance,
            parts.pigments,
            parts.turns,
            parts.edits,
        )

    def _scales_behind(
        self,
        parts: Unpacked,
        photo: int,
        light: tuple[Float[Tensor, "b n 3"], Float[Tensor, "b 3"]],
    ) -> Float[Tensor, "s b"]:
        """How unlikely a background is in light over each of :data:`SCALES`, in nats."""
        term = self.backgrounds[photo]
        light_over = term.seen(*light) / SCALES.to(light[0])[:, None, None, None]
        tried = self.camera_response(parts, photo, light_over)
        return self.weights.background * term.cost(term.deviation(tried))

    def __call__(
        self, free: Float[Tensor, "b q"], problem: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, " b"]:
        """Of points in ascending order of their problems; None where there is but one."""
        return torch.stack(list(self.terms(free, problem).values())).sum(0)
