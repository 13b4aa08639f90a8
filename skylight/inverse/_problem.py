"""Problems of inverse lighting: observations are added, and all lights are solved for at once.

Each light model has its problem: :mod:`~skylight.inverse._sky`, :mod:`~skylight.inverse._lamps`,
:mod:`~skylight.inverse._harmonic`, and :mod:`~skylight.inverse._auto` for models that compete.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from skylight.errors import InputError
from skylight.inverse._result import Estimate
from skylight.transport._observation import Observation
from skylight.work._progress import Progress


class LightProblem(ABC):
    """Find the light of some observations: give it each of them, then :func:`solve`.

    An observation can be let go once it is added: of several faces, only one at a time need be
    held with its full transport.
    """

    uses_specular: ClassVar[bool] = True  # whether transport of surface reflection is of use
    uses_background: ClassVar[bool] = False  # whether what stands behind the faces is of use

    @property
    @abstractmethod
    def grid_height(self) -> int:
        """Rows of lat-long directions that the transport of observations has at least."""

    @property
    @abstractmethod
    def is_empty(self) -> bool:
        """Nothing was added yet."""

    @abstractmethod
    def add(self, observation: Observation, photo: int = 0) -> None:
        """One more observation, of photograph number ``photo``; photographs come in order."""

    @abstractmethod
    def _solve(self, progress: Progress) -> Estimate:
        """The light under which the observations are likeliest; there is at least one."""

    @classmethod
    def _solve_each(cls, problems: Sequence["LightProblem"], progress: Progress) -> list[Estimate]:
        """The light of each of several problems, by default in turn."""
        found: list[Estimate] = []
        for done, problem in enumerate(problems):

            def partial(share: float, done: int = done) -> None:
                progress((done + share) / len(problems))

            found.append(problem._solve(partial))
        return found


def solve(problems: Sequence[LightProblem], progress: Progress | None = None) -> list[Estimate]:
    """The light of each problem; all are of one light model.

    Skies are solved as one batch (:class:`~skylight.inverse._sky.SkyProblem`), other problems in
    turn. What is found does not depend on the others but for rounding.
    """
    require_observations(not any(problem.is_empty for problem in problems))
    if not problems:
        return []
    return type(problems[0])._solve_each(problems, progress or (lambda _share: None))


def require_observations(are_there: bool) -> None:
    """:class:`InputError` where there are none."""
    if not are_there:
        raise InputError("there is no observation to estimate light from; give at least one")
