"""Observations of one light -> that light as spherical harmonics: a robust linear problem.

The light is nowhere negative (thesis, Fig. 7.1): :func:`nonnegative_harmonics`, which known objects
use too.
"""

import copy
import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.inverse._faces import ObjectiveWeights, data_term
from skylight.inverse._gauss_newton import charbonnier
from skylight.inverse._posterior import face_evidence, sun_evidence
from skylight.inverse._problem import LightProblem
from skylight.inverse._result import (
    MAP_ROWS,
    Estimate,
    FaceLight,
    misplaced_shading,
    residual,
)
from skylight.inverse._scale import bayes_scale, scale_nll, tone_prior
from skylight.inverse._scan import SCAN_HEIGHT, scan_faces
from skylight.inverse._solution import Search, estimate_of
from skylight.inverse._sun_prior import SunPrior
from skylight.models._harmonic import HarmonicLight, solve_linear
from skylight.models._prior import GaussianMixture
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid
from skylight.transport._observation import Observation
from skylight.work._progress import Progress

CONSTRAINTS = 1024


@dataclass(frozen=True, kw_only=True, eq=False)
class NonNegativeHarmonics:
    """``coefficients`` (k,c) of :func:`skylight.sphere._harmonics.evaluate`, float64.

    ``multipliers`` (j,c), >= 0, of ``Y(w_j) c >= 0``: above 0 only where the light touches 0.
    With ``ridge`` they prove the optimum, ``A^T (A c - s) + ridge c = Y^T multipliers``.
    """

    coefficients: Float[Tensor, "k c"]
    multipliers: Float[Tensor, "j c"]
    ridge: float

    @property
    def degree(self) -> int:
        return harmonics.degree_of(len(self.coefficients))

    def radiance(self, grid: DirectionGrid) -> Float[Tensor, "n c"]:
        """The light in the grid's directions."""
        basis = harmonics.evaluate(grid.directions, self.degree)
        return basis.to(self.coefficients) @ self.coefficients


def nonnegative_harmonics(
    operator: Float[Tensor, "m k"],
    shading: Float[Tensor, "m c"],
    *,
    noise: float = 0.01,
    constraints: DirectionGrid | None = None,
) -> NonNegativeHarmonics:
    """``argmin_c |A c - s|^2 + r |c|^2`` subject to ``sum_lm Y_lm(w_j) c_lm >= 0``, per colour.

    ``operator``
        A: what each harmonic lets the points show, e.g.
        ``TransportMatrix.project(harmonics.evaluate(grid.directions, 4))`` times the albedo.
    ``noise``
        Standard deviation of the shading's errors relative to its root mean square. It sets the
        ridge to ``noise^2 |A|_F^2 / m``, the best for coefficients of equal variance.
    ``constraints``
        The w_j, 1024 Hammersley directions if not given. Between them the light may fall below 0
        by at most 5 % of its range at degree 4 (Bernstein), and 0.6 % in our tests.

    The problem is turned into one of least distance, ``min |z|`` with ``E z >= h`` where
    ``z = R c - f``, ``[A; sqrt(r) I] = Q R`` and ``f = Q^T [s; 0]``, and that into non-negative
    least squares (Lawson and Hanson 1974, 23.4: LSI and LDP). It has one solution.
    """
    grid = constraints or DirectionGrid.hammersley(CONSTRAINTS)
    degree = harmonics.degree_of(operator.shape[1])
    matrix, right = operator.double(), shading.double()
    if not bool(matrix.isfinite().all()) or not bool(right.isfinite().all()):
        raise InputError("shading or transfer have values that are NaN or infinite")
    count = matrix.shape[1]
    ridge = noise**2 * float(matrix.square().sum()) / len(matrix)
    stacked = torch.cat([matrix, math.sqrt(ridge) * torch.eye(count).to(matrix)])
    orthogonal, triangle = torch.linalg.qr(stacked)
    # what remains is small, and on the CPU
    best = (orthogonal[: len(matrix)].T @ right).cpu()
    triangle = triangle.cpu()
    pivots = triangle.diagonal().abs()
    if not float(pivots.min()) > 1e-7 * float(pivots.max()):
        raise InputError(
            f"the points do not tell {count} harmonics apart: give more points or the noise"
        )
    basis = harmonics.evaluate(grid.directions, degree)
    rows = torch.linalg.solve_triangular(triangle, basis, upper=True, left=False)  # E = Y R^-1
    nearest, multipliers = zip(
        *(_least_distance(rows, -rows @ target, float(target.norm())) for target in best.T),
        strict=True,
    )
    distance = torch.stack(nearest, dim=1)
    return NonNegativeHarmonics(
        coefficients=torch.linalg.solve_triangular(triangle, distance + best, upper=True).to(
            operator.device
        ),
        multipliers=torch.stack(multipliers, dim=1).to(operator.device),
        ridge=ridge,
    )


def _least_distance(
    rows: Float[Tensor, "j k"], least: Float[Tensor, " j"], scale: float
) -> tuple[Float[Tensor, " k"], Float[Tensor, " j"]]:
    """(z of least length with ``rows z >= least``, its multipliers: ``z = rows^T multipliers``).

    There must be one of a length of at most ``scale``.
    """
    if scale == 0:
        return torch.zeros_like(rows[0]), torch.zeros_like(least)
    system = torch.cat([rows.T, least[None] / scale])
    target = np.zeros(len(system))
    target[-1] = 1
    from scipy.optimize import nnls  # takes 0.2 s to import

    weights, _ = nnls(system.numpy(), target)
    # what is left of the target is 1 / (1 + |z|^2), at least 1/2
    left = 1 - float(system[-1] @ torch.from_numpy(weights))
    multipliers = scale / left * torch.from_numpy(weights)
    return rows.T @ multipliers, multipliers


ROWS = 32  # of transport: shadows' edges within 3 degrees do for light of degree 4
RIDGE = 1e-6  # relative, as in solve_linear
COLOUR_RIDGE = 1e-6  # of the changes of the faces' colours, which must not be slowed
REWEIGHTINGS = 8
MOST_REWEIGHTINGS = 30  # where several faces share a light
SETTLED = 1e-3  # a smaller relative change of the faces' colours
DAYLIGHT_CHROMA = 0.15  # by which daylight varies in the log of its channels' ratios


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """``product`` the first albedo times the coefficients, ``mean`` what that shades on average.

    ``colour`` (f,3) the faces' factors on it, ``data`` the data term of that light, in nats.
    """

    product: Float[Tensor, "k 3"]
    colour: Float[Tensor, "f 3"]
    mean: Float[Tensor, "3"]
    data: float
    rounds: int
    settled: bool


class HarmonicProblem(LightProblem):
    """SH coefficients from all faces under one light.

    Surface reflection is left out, in the posterior too: highlights count as outliers. Keeps
    each observation's transport on :data:`ROWS` rows, without its specular reflection. Where one of
    the pictures is grey all are taken for grey: the light is neutral, and luminance alone is
    fitted. Everything is computed on the device of ``albedo_modes``, where the model and the prior
    have to be; the estimate is on the CPU.
    """

    uses_specular = False

    def __init__(
        self,
        model: HarmonicLight,
        albedo_prior: GaussianMixture,
        albedo_modes: Float[Tensor, "k 3"],
        sun_prior: SunPrior | None = None,
    ) -> None:
        self.model = model
        self.sun_prior = sun_prior
        basis = harmonics.evaluate(DirectionGrid.latlong(ROWS).directions, model.degree)
        self.basis = basis.to(albedo_modes.device)
        # of few numbers, which the host decides by
        self.albedo_prior = copy.deepcopy(albedo_prior).cpu()
        self.tone_prior = tone_prior(self.albedo_prior)
        self.albedo_modes = albedo_modes
        self._faces: list[Observation] = []
        self._photos: list[int] = []
        self._scanned: list[Observation] = []

    @property
    def grid_height(self) -> int:
        return ROWS

    @property
    def is_empty(self) -> bool:
        return not self._faces

    def add(self, observation: Observation, photo: int = 0) -> None:
        _ = observation.mean_luminance  # refuses what is black
        observation = observation.to(self.albedo_modes.device)
        weights = observation.weights
        if observation.clipped is not None:  # a linear fit has no use for bounds
            weights = weights * ~observation.clipped
            if not bool((weights > 0).any()):
                raise InputError("the whole face is over-exposed; use a darker picture")
        diffuse = replace(observation, specular=None)
        self._faces.append(replace(diffuse, weights=weights).on_rows(ROWS))
        self._photos.append(photo)
        self._scanned.append(diffuse.coarser(1).on_rows(SCAN_HEIGHT))

    def _solve(self, progress: Progress) -> Estimate:
        """Robust fit of non-negative light by reweighted linear least squares.

        A pixel's weight is divided by its mean Charbonnier residual over the channels, which
        share it. Shading is linear in the coefficients, so there is no start to choose. A face
        says little of what it does not see, and there the best coefficients swing far below zero:
        with the weights and factors they end with, the light is fitted once more, under the
        constraint that it is not negative at 1,024 directions
        (:func:`~skylight.inverse._harmonic.nonnegative_harmonics`). Several faces have
        a colour factor each (albedo times exposure; the first one's is 1), and light and factors
        are fitted together, by Gauss-Newton steps that share the reweighting.
        ``status`` is "converged" unless they did not settle.
        """
        model = self.model
        if self._grey:
            self._faces = [replace(face, pixels=_grey(face.pixels)) for face in self._faces]
        faces = self._faces
        fit = self._fit()
        albedos, exposures = self._split(fit.colour.cpu(), fit.mean.cpu())
        albedos = albedos.to(fit.product.device)
        seen = _grey(albedos) if self._grey else albedos
        coefficients = (fit.product / seen[0]).float()
        with torch.no_grad():
            radiance = model.on_rows(MAP_ROWS)(coefficients.reshape(1, -1))[0]
        environment = EnvironmentMap(radiance=radiance.reshape(MAP_ROWS, -1, 3).float().cpu())
        coarse = environment.resize(ROWS).flat.to(radiance.device)
        lights = []
        for k, (face, photo) in enumerate(zip(faces, self._photos, strict=True)):
            rendered = exposures[photo] * seen[k].float() * (face.transport.matrix @ coarse)
            lights.append(
                FaceLight(
                    photo=photo,
                    exposure=exposures[photo],
                    white_balance=torch.ones(3),  # the light is free in colour, and takes it
                    albedo=albedos[k].float().cpu(),
                    pixel_albedo=albedos[k].float().cpu().expand(len(rendered), -1),
                    specular_scale=0.0,
                    rendered=rendered.cpu(),
                    residual=residual(rendered, face.pixels, face.clipped),
                    misplaced=misplaced_shading(rendered.cpu(), face.to(torch.device("cpu"))),
                )
            )
        progress(1.0)
        # harmonics this smooth have no sun of their own to add to the scan's
        return estimate_of(
            model.name,
            coefficients.reshape(-1).cpu(),
            environment,
            tuple(lights),
            Search(
                terms={"data": fit.data},
                status="converged" if fit.settled else "iteration limit",
                stats={"evaluations": fit.rounds, "nonfinite": 0},
            ),
            sun_evidence(face_evidence(self._scanned, scan_faces(self._scanned))),
            sun=None,
            albedo_prior=self.tone_prior,
            reflects=False,
            sun_prior=self.sun_prior,
        )

    @property
    def _grey(self) -> bool:
        return any(face.grey for face in self._faces)

    def _fit(self) -> "_Fit":
        # float64: rounding in the reweighting does not reach the float32 of the result
        shading = [face.transport.project(self.basis).double() for face in self._faces]
        faces = self._faces
        pixels = [face.pixels.double() for face in faces]
        means = [float(luminance(p).mean()) for p in pixels]
        # each face counts alike, as in the objective
        first = faces[0].weights.double().sum()
        given = [f.weights.double() * (first / f.weights.double().sum()) for f in faces]
        colour = torch.stack([(w[:, None] * p).sum(0) for w, p in zip(given, pixels, strict=True)])
        colour = (colour / colour[0]).clamp(min=1e-6)
        weights = given
        lit: list[Float[Tensor, "_ 3"]] = []
        for rounds in range(1, MOST_REWEIGHTINGS + 1):
            product, change = _gauss_newton(
                shading,
                [p / c for p, c in zip(pixels, colour, strict=True)],
                torch.cat(weights),
                lit,
            )
            lit = [one @ product for one in shading]
            colour = colour * change
            gaps = _gaps(lit, colour, pixels, means)
            weights = [w / charbonnier(gap).mean(1) for w, gap in zip(given, gaps, strict=True)]
            settled = bool((change.log().abs() < SETTLED).all())
            if settled and rounds >= REWEIGHTINGS:
                break
        shares = [w[:, None] / w.sum() / 3 for w in given]
        product = _nonnegative(
            torch.cat(shading),
            torch.cat([p / c for p, c in zip(pixels, colour, strict=True)]),
            torch.cat(weights),
        )
        # between the directions that hold it the light may still fall below zero a little
        light = (self.basis @ product).clamp(min=0).float()
        lit = [(face.transport.matrix @ light).double() for face in faces]
        gaps = _gaps(lit, colour, pixels, means)
        return _Fit(
            product=product,
            colour=colour,
            mean=torch.cat(lit).mean(0).clamp(min=1e-6 * means[0]),
            data=sum(
                float(data_term(gap, share, ObjectiveWeights()))
                for gap, share in zip(gaps, shares, strict=True)
            ),
            rounds=rounds,
            settled=settled,
        )

    def _split(
        self, colour: Float[Tensor, "f 3"], mean: Float[Tensor, "3"]
    ) -> tuple[Float[Tensor, "f 3"], list[float]]:
        """(albedos, exposure of each photograph) from the faces' colour factors.

        The fit knows only albedo times light (the ambiguity of Eq. 5.9). Of the skin prior's
        modes, as albedos of the first photograph's faces, the one is taken that leaves the light
        most neutral, plus its negative log-likelihood, for all faces that follow from it. A
        further photograph is exposed so that one of its faces is as bright as a mode. Then every
        photograph is brought to the :func:`bayes_scale` of its albedos.
        """
        modes = self.albedo_modes.cpu().double()
        rows = [[k for k, p in enumerate(self._photos) if p == n] for n in sorted({*self._photos})]
        best: tuple[float, Float[Tensor, "f 3"], list[float]] | None = None
        for lead in rows[0]:
            for mode in modes:
                # albedos up to the exposure of each photograph; exactly the mode for its face
                albedos = colour / colour[lead] * mode
                chroma = torch.log(mean / (_grey(albedos[0]) if self._grey else albedos[0]))
                cost = 0.5 * float(((chroma - chroma.mean()) ** 2).sum()) / DAYLIGHT_CHROMA**2
                exposures = [1.0]
                for mine in rows[1:]:
                    levels = luminance(albedos[mine])[:, None] / luminance(modes)
                    nll = [self._nll(albedos[mine] / level) for level in levels.flatten()]
                    exposures.append(float(levels.flatten()[nll.index(min(nll))]))
                    albedos[mine] /= exposures[-1]
                cost += self._nll(albedos)
                if best is None or cost < best[0]:
                    best = cost, albedos, exposures
        assert best is not None
        _, albedos, exposures = best
        for photo, mine in enumerate(rows):
            nll = scale_nll(albedos[mine][None].float(), self.tone_prior)
            scale = float(bayes_scale(nll))
            albedos[mine] *= scale
            # the light is the one over the first albedo: it changes with the first photograph
            exposures[photo] /= scale
        return albedos, [exposure / exposures[0] for exposure in exposures]

    def _nll(self, albedos: Float[Tensor, "f 3"]) -> float:
        """-ln p of all albedos together."""
        return -float(self.albedo_prior.log_prob(albedos.log().float()).sum())


def _grey(colours: Float[Tensor, "*s 3"]) -> Float[Tensor, "*s 3"]:
    """Their luminance in all three channels."""
    return luminance(colours)[..., None].expand_as(colours)


def _gaps(
    lit: list[Float[Tensor, "_ 3"]],
    colour: Float[Tensor, "f 3"],
    pixels: list[Float[Tensor, "_ 3"]],
    means: list[float],
) -> list[Float[Tensor, "_ 3"]]:
    """How far each face is from what is lit, relative to its mean luminance."""
    return [
        (one * c - p) / mean for one, c, p, mean in zip(lit, colour, pixels, means, strict=True)
    ]


def _nonnegative(
    shading: Float[Tensor, "m k"],
    pixels: Float[Tensor, "m 3"],
    weights: Float[Tensor, " m"],
) -> Float[Tensor, "k 3"]:
    """:func:`solve_linear` with :data:`RIDGE`, of light that is nowhere negative."""
    root = weights.sqrt()[:, None]
    points, count = shading.shape
    noise = math.sqrt(RIDGE * points / count)  # of which RIDGE is the ridge
    return nonnegative_harmonics(root * shading, root * pixels, noise=noise).coefficients


def _gauss_newton(
    shading: list[Float[Tensor, "_ k"]],
    pixels: list[Float[Tensor, "_ 3"]],
    weights: Float[Tensor, " m"],
    lit: list[Float[Tensor, "_ 3"]],
) -> tuple[Float[Tensor, "k 3"], Float[Tensor, "f 3"]]:
    """(coefficients, factors by which the faces' colours change), the first face's being 1.

    ``pixels`` are over the colours so far. A face is modelled by B c + x (B c_0), with the
    ``lit`` B c_0 of the step before, and its colour grows by 1 + x; with ``lit`` empty it stays.
    """
    faces, coefficients = len(shading), shading[0].shape[1]
    product = shading[0].new_zeros(coefficients, 3)
    change = shading[0].new_ones(faces, 3)
    for channel in range(3):
        basis = torch.cat(shading)
        if lit:
            column = [one[:, channel : channel + 1] for one in lit]
            basis = torch.cat([basis, torch.block_diag(*column)[:, 1:]], 1)
        ridges = basis.new_full((basis.shape[1],), COLOUR_RIDGE, dtype=torch.float32)
        ridges[:coefficients] = RIDGE
        solution = solve_linear(basis, torch.cat(pixels), weights, ridge=ridges)[:, channel]
        product[:, channel] = solution[:coefficients]
        if lit:
            change[1:, channel] += solution[coefficients:].clamp(-0.5, 1.0)
    return product, change
