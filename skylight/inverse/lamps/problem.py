"""Observations under one light -> that light as lamps in ambient light."""

from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.inverse.lamps.solver import LampsOptions, LampsSolver
from skylight.inverse.objective.lit_faces import LitFaces, ScannedFace
from skylight.inverse.result import Estimate
from skylight.inverse.scan import SCAN_HEIGHT
from skylight.models.prior import GaussianMixture
from skylight.transport.observation import Observation
from skylight.work.progress import Progress


class LampsProblem:
    """Eq. 5.8 for all faces under one light that is no sky: give it each face, then solve.

    Light is on :data:`~skylight.inverse.scan.SCAN_HEIGHT` rows of the sphere: two thirds of the
    memory that a sky has, 130 MB for a face of 3,700 pixels with gloss.
    """

    grid_height = SCAN_HEIGHT
    uses_gloss = True

    def __init__(
        self,
        albedo_prior: GaussianMixture,
        albedo_modes: Float[Tensor, "k 3"],
        options: LampsOptions | None = None,
    ) -> None:
        self.solver = LampsSolver(
            albedo_prior=albedo_prior,
            albedo_modes=albedo_modes,
            options=options or LampsOptions(),
        )
        self.faces = LitFaces()

    def add(self, observation: Observation, photo: int = 0) -> None:
        """One more face; photographs come in order, counted from 0."""
        device = self.solver.albedo_modes.device
        levels = self.solver.options.levels
        coarse = observation.on_rows(SCAN_HEIGHT)
        self.faces.append(ScannedFace.of(coarse, photo, levels, device, sphere=True))

    def solve(self, progress: Progress | None = None) -> Estimate:
        """Minimise Eq. 5.8 for as many lamps as pay, as :meth:`LampsSolver.solve` does.

        Raises
        ------
        InputError
            Nothing was added.
        """
        if not self.faces:
            raise InputError("there is no observation to estimate light from; give at least one")
        return self.solver.solve(self.faces, progress)
