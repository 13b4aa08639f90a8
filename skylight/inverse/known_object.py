"""The light in which any object of known shape was photographed (thesis, 6.5)."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import nnls
from torch import Tensor

from skylight.csc.dictionary import FilterBank, builtin
from skylight.csc.layers import Layer
from skylight.csc.objective import LinearObservation
from skylight.csc.positions import Positions
from skylight.csc.pursuit import Pursuit, PursuitOptions, Support
from skylight.csc.search import pursue
from skylight.errors import InputError
from skylight.inverse.object_view import GRID_HEIGHT, ObjectMaterial, shading
from skylight.models.harmonic import solve_linear
from skylight.sphere import harmonics
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.grid import DirectionGrid
from skylight.transport.observation import Observation

ObjectLightName = Literal["ani", "iso", "vmf", "sh9", "sh25", "sh49"]
MAP_HEIGHT = 64
LEAST_GAIN = 0.01  # of the squared error, by PATIENCE activations together
PATIENCE = 3
POOR_FIT = 0.25
RIDGES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
RIDGE_COST = 0.1


@dataclass(frozen=True, kw_only=True)
class ObjectLight:
    """The light of a known object's picture, in the mesh's world and the picture's units.

    ``environment``
        64 x 128, cut off at zero; ``clamped_share`` is what that took away:
        ``int max(0, -L) / int |L|``, over all colours.
    ``coefficients``
        (k,3), before that cut: of :func:`skylight.sphere.harmonics.evaluate`, or, where ``code``
        is given, of :func:`skylight.sphere.harmonics.evaluate_about_zenith`.
    ``rendered``
        (m,3), the observation's pixels under ``environment``; ``residual`` is their difference
        from those seen, root of weighted mean squares, relative to the pixels'. ``linear_residual``
        is the same before the cut.
    ``code``, ``code_directions``
        The activations, and where they stand (s,3).
    """

    light: str
    environment: EnvironmentMap
    coefficients: Float[Tensor, "k 3"]
    rendered: Float[Tensor, "m 3"]
    residual: float
    linear_residual: float
    clamped_share: float
    advice: tuple[str, ...]
    dictionary: FilterBank | None = None
    code: Support | None = None
    code_directions: Float[Tensor, "s 3"] | None = None


def estimate_object_light(
    observation: Observation,
    light: ObjectLightName | FilterBank,
    *,
    material: ObjectMaterial | None = None,
    activations: int = 50,
    progress: Callable[[float], None] | None = None,
) -> ObjectLight:
    """Minimise ``sum_p w_p |s_p - (T l)_p|^2`` (thesis, Eq. 6.18) over lights of one kind.

    Spherical harmonics are solved for linearly, with the largest ridge (1e-2 .. 1e-6) that raises
    the squared error by a tenth at most: a matt object hardly shows some of them. Sparse codes
    grow by one activation at a time, up to ``activations``, and end where three together lower
    the squared error by less than 1 %; the shortest code within 1 % of the least error is taken.
    All colours share their activations; each colour's weights are then fitted to its own albedo,
    none below 0.

    Parameters
    ----------
    light : spherical harmonics, a dictionary of the thesis, or a dictionary of one's own.
    material : that with which the object was observed.
    """
    material = material or ObjectMaterial()
    if (material.specular is None) != (observation.gloss is None):
        raise ValueError("material and observation disagree about gloss")
    if activations < 1:
        raise InputError(f"a sparse code has 1 or more activations, got {activations}")
    bank, code, directions = None, None, None
    if isinstance(light, str) and light not in get_args(ObjectLightName):
        raise InputError(
            f"unknown light {light!r}: choose one of {', '.join(get_args(ObjectLightName))}"
        )
    if isinstance(light, FilterBank) or light == "ani" or light == "iso" or light == "vmf":
        bank = light if isinstance(light, FilterBank) else builtin(light)
        name, fine = bank.name, _basis(bank.degree, harmonics.evaluate_about_zenith)
        linear = _Shading.of(observation, material, fine)
        code, atoms, directions = _sparse_code(linear, bank, activations, progress)
        coefficients = atoms.T @ code.weights
    else:
        name, fine = light, _basis(math.isqrt(int(light[2:])) - 1, harmonics.evaluate)
        linear = _Shading.of(observation, material, fine)
        coefficients = _harmonic_coefficients(linear)
    radiance = fine @ coefficients
    environment = EnvironmentMap(
        radiance=radiance.clamp(min=0).float().reshape(MAP_HEIGHT, 2 * MAP_HEIGHT, 3)
    )
    share = DirectionGrid.latlong(MAP_HEIGHT).solid_angles[:, None]
    taken = float((share * (-radiance).clamp(min=0)).sum() / (share * radiance.abs()).sum())
    rendered = shading(
        observation.transport, observation.gloss, environment.resize(GRID_HEIGHT).flat, material
    )
    residual = _relative_error(observation, rendered)
    return ObjectLight(
        light=name,
        environment=environment,
        coefficients=coefficients,
        rendered=rendered,
        residual=residual,
        linear_residual=_relative_error(observation, linear.apply(coefficients)),
        clamped_share=taken,
        advice=_advice(residual),
        dictionary=bank,
        code=code,
        code_directions=directions,
    )


@dataclass(frozen=True, kw_only=True)
class _Shading:
    """Pixels as a linear map of coefficients: ``albedo_c matt + share gloss``, (m,k) each."""

    observation: Observation
    material: ObjectMaterial
    matt: Float[Tensor, "m k"]
    gloss: Float[Tensor, "m k"] | None

    @staticmethod
    def of(
        observation: Observation, material: ObjectMaterial, fine: Float[Tensor, "n k"]
    ) -> "_Shading":
        """``fine`` is the basis on the pixels of the map; its means over cells meet transport."""
        coarse = _cell_means(fine)
        gloss = observation.gloss
        return _Shading(
            observation=observation,
            material=material,
            matt=observation.transport.project(coarse).double(),
            gloss=None if gloss is None else gloss.project(coarse).double(),
        )

    def operator(self, colour: int) -> Float[Tensor, "m k"]:
        return self.mixed(self.material.albedo[colour])

    def mixed(self, albedo: float) -> Float[Tensor, "m k"]:
        """``albedo matt + share gloss``."""
        matt = albedo * self.matt
        return matt if self.gloss is None else matt + self.material.share * self.gloss

    def apply(self, coefficients: Float[Tensor, "k 3"]) -> Float[Tensor, "m 3"]:
        return torch.stack([self.operator(c) @ coefficients[:, c] for c in range(3)], dim=1)


def _harmonic_coefficients(linear: _Shading) -> Float[Tensor, "k 3"]:
    """Least squares by the discrepancy principle (Morozov 1966), per colour with its albedo."""
    weights, pixels = linear.observation.weights.double(), linear.observation.pixels.double()

    def solved(ridge: float) -> tuple[Float[Tensor, "k 3"], float]:
        coefficients = torch.stack(
            [
                solve_linear(linear.operator(c), pixels, weights, ridge=ridge)[:, c]
                for c in range(3)
            ],
            dim=1,
        )
        return coefficients, _relative_error(linear.observation, linear.apply(coefficients))

    solutions = [solved(ridge) for ridge in RIDGES]
    enough = math.sqrt(1 + RIDGE_COST) * solutions[-1][1]
    return next(coefficients for coefficients, error in solutions if error <= enough)


def _sparse_code(
    linear: _Shading,
    bank: FilterBank,
    activations: int,
    progress: Callable[[float], None] | None,
) -> tuple[Support, Float[Tensor, "s k"], Float[Tensor, "s 3"]]:
    """Activations, the turned filters, and where they stand.

    The activations are sought for an albedo that is grey (the mean), with pixels divided by the
    albedo's colour: exact but for gloss on a coloured object. The weights are then those of
    non-negative least squares with each colour's own albedo.
    """
    positions = Positions()
    layer = Layer(bank, positions)
    albedo = torch.tensor(linear.material.albedo, dtype=torch.float64)
    tint = albedo / albedo.mean() if float(albedo.min()) > 0 else torch.ones_like(albedo)
    pixels, weights = linear.observation.pixels.double(), linear.observation.weights.double()
    objective = LinearObservation.of(linear.mixed(float(albedo.mean())), pixels / tint, weights)
    pursuit = Pursuit([layer], objective, PursuitOptions(weights="nonnegative"))
    found: list[Support] = []
    for code in pursue(pursuit, list(range(1, activations + 1))):
        found.append(code)
        if progress is not None:
            progress(len(found) / activations)
        before = min((c.error for c in found[:-PATIENCE]), default=math.inf)
        if min(c.error for c in found) > (1 - LEAST_GAIN) * before:
            break
    enough = min(c.error for c in found) / (1 - LEAST_GAIN)
    code = next(c for c in found if c.error <= enough)
    if not len(code):
        raise InputError(
            "no light explains the picture: the object's pixels are black, or none sees any light"
        )
    atoms = layer.correlation.rotated(code.filters, code.places).cpu()
    root = weights.sqrt()[:, None]
    values = np.zeros((len(code), 3))
    for c in range(3):
        columns = root * (linear.operator(c) @ atoms.T)
        values[:, c], _ = nnls(columns.numpy(), (root[:, 0] * pixels[:, c]).numpy())
    used = torch.from_numpy(values.any(1))
    atoms, kept = atoms[used], torch.from_numpy(values)[used]
    difference = linear.apply(atoms.T @ kept) - pixels
    code = Support(
        filters=code.filters[used],
        places=code.places[used],
        weights=kept,
        error=float((weights[:, None] * difference.square()).sum()),
    )
    return code, atoms, positions.directions(code.places)


def _basis(degree: int, evaluate: Callable[[Tensor, int], Tensor]) -> Float[Tensor, "n k"]:
    """The harmonics on the pixels of the map."""
    return evaluate(DirectionGrid.latlong(MAP_HEIGHT).directions, degree)


def _cell_means(fine: Float[Tensor, "n k"]) -> Float[Tensor, "n2 k"]:
    """Means of functions on the map over the cells of the transport's grid, as maps are resized."""
    factor = MAP_HEIGHT // GRID_HEIGHT
    weight = DirectionGrid.latlong(MAP_HEIGHT).solid_angles[:, None]
    cells = (GRID_HEIGHT, factor, 2 * GRID_HEIGHT, factor, -1)
    total = (weight * fine).reshape(cells).sum((1, 3))
    return (total / weight.reshape(cells).sum((1, 3))).flatten(0, 1)


def _relative_error(observation: Observation, rendered: Float[Tensor, "m 3"]) -> float:
    """``sqrt(sum w |rendered - seen|^2 / sum w |seen|^2)``."""
    weights = observation.weights.double()[:, None]
    seen = observation.pixels.double()
    error = (weights * (rendered.double() - seen).square()).sum()
    return float((error / (weights * seen.square()).sum()).sqrt())


def _advice(residual: float) -> tuple[str, ...]:
    if residual > POOR_FIT:
        return (
            f"the re-rendered object is off by {100 * residual:.0f} %: the light is unreliable; "
            "check that mesh and camera fit the picture, and leave out painted parts with a mask",
        )
    return ()
