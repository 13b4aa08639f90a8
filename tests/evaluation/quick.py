"""Little effort, for evaluations whose tests look at what is done and not at how well."""

from skylight.evaluation._known_faces import EstimateOptions
from skylight.inverse._descent import Round
from skylight.inverse._faces import Level
from skylight.inverse._sky import SolverOptions

QUICK = EstimateOptions(
    solver=SolverOptions(
        rounds=(
            Round(level=Level(3), starts=3, iterations=6),
            Round(level=Level(0), starts=1, iterations=2),
        )
    )
)
