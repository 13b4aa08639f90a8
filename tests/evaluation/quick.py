"""Little effort, for evaluations whose tests look at what is done and not at how well."""

from skylight.evaluation._known_faces import EstimateOptions
from skylight.inverse._descent import Stage
from skylight.inverse._faces import Level
from skylight.inverse._sky import SolverOptions

QUICK = EstimateOptions(
    solver=SolverOptions(
        stages=(
            Stage(level=Level(3), starts=3, iterations=6),
            Stage(level=Level(0), starts=1, iterations=2),
        )
    )
)
