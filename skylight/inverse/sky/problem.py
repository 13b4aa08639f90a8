"""Observations under one sky -> that sky: Eq. 5.8, of one light or of several at once."""

from collections import defaultdict
from collections.abc import Sequence
from copy import copy

from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.inverse.objective.lit_faces import LitFaces, ScannedFace
from skylight.inverse.result import Estimate
from skylight.inverse.sky.solver import SkySolver, SolverOptions
from skylight.inverse.sun_prior import SunPrior
from skylight.models.base import LightModel, Prior
from skylight.models.prior import GaussianMixture
from skylight.transport.observation import Observation
from skylight.work.progress import Progress


class SkyProblem:
    """Eq. 5.8 for all faces under one light: give it each face, then solve.

    The faces of one photograph share its exposure. Of an observation's transport only the
    sky's half is kept, folded with the ground: with the pyramid 0.7 times as much memory as
    the observation's own, 35 MB for a face in 700 blocks of pixels seen on 64 rows with gloss. Let
    go of each observation once it is added.

    Everything is computed on the device of ``albedo_modes``, where ``model`` and the priors have
    to be; observations are moved there when they are added. The estimate is on the CPU.
    """

    uses_gloss = True

    def __init__(
        self,
        model: LightModel,
        light_prior: Prior,
        albedo_prior: GaussianMixture,
        albedo_modes: Float[Tensor, "k 3"],
        options: SolverOptions | None = None,
        sun_prior: SunPrior | None = None,
    ) -> None:
        self.solver = SkySolver(
            model=model,
            light_prior=light_prior,
            albedo_prior=albedo_prior,
            albedo_modes=albedo_modes,
            options=options or SolverOptions(),
        )
        self.faces = LitFaces(sun_prior)

    def another(self, sun_prior: SunPrior | None = None) -> "SkyProblem":
        """An empty problem with the same model, priors and options, to be solved with this one.

        What clock and place tell of the sun is its own.
        """
        problem = copy(self)
        problem.faces = LitFaces(sun_prior)
        return problem

    @property
    def grid_height(self) -> int:
        """Of the observations that it needs: the sky's rows and the ground's."""
        layout = self.solver.model.grid.layout
        assert layout is not None
        return 2 * layout[0]

    def add(self, observation: Observation, photo: int = 0) -> None:
        """One more face; photographs come in order, counted from 0.

        Raises
        ------
        ValueError
            The observation's light is not on :attr:`grid_height` rows.
        """
        layout = observation.transport.grid.layout
        if layout is None or layout[0] != self.grid_height:
            raise ValueError(f"a sky needs transport of {self.grid_height} rows, got {layout}")
        levels = sorted({one.level for one in self.solver.options.rounds})
        device = self.solver.albedo_modes.device
        self.faces.append(ScannedFace.of(observation, photo, levels, device))

    def solve(self, progress: Progress | None = None) -> Estimate:
        """Minimise Eq. 5.8 from the best of many starts, as :meth:`SkySolver.solve` does.

        Raises
        ------
        InputError
            Nothing was added.
        """
        return self.solver.solve([self.faces], progress)[0]


def solve_together(
    problems: Sequence[SkyProblem], progress: Progress | None = None
) -> list[Estimate]:
    """The light of each problem, as :meth:`SkyProblem.solve` finds it but for rounding.

    Problems of one shape, with as many faces in the same photographs, all with gloss or none and
    all grey or none, are solved as one batch; numbers of pixels may differ. What a problem holds
    is copied level by level, padded to the most pixels: beside the 185 MB of a face of 3,700
    pixels with gloss that is up to 120 MB, 9 GB for a batch of 32 such faces, and 1.3 GB for the
    autoencoder's gradients with respect to ten starts of each.

    Raises
    ------
    InputError
        Nothing was added to one of them.
    ValueError
        A problem that is not :meth:`SkyProblem.another` of the first.
    """
    if not problems:
        return []
    solver = problems[0].solver
    if any(problem.solver is not solver for problem in problems):
        raise ValueError("problems solved together share a solver: make them by another()")
    if not all(problem.faces for problem in problems):
        raise InputError("there is no observation to estimate light from; give each at least one")
    groups: dict[tuple, list[int]] = defaultdict(list)
    for number, problem in enumerate(problems):
        groups[problem.faces.shape].append(number)
    found: dict[int, Estimate] = {}
    for done, numbers in enumerate(groups.values()):

        def told(share: float, done: int = done) -> None:
            if progress is not None:
                progress((done + share) / len(groups))

        estimates = solver.solve([problems[k].faces for k in numbers], told)
        found.update(zip(numbers, estimates, strict=True))
    return [found[k] for k in range(len(problems))]
