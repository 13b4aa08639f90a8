"""Little effort, for evaluations whose tests look at what is done and not at how well."""

from skylight.evaluation.faces.options import EstimateOptions
from skylight.inverse.objective.descent import Round
from skylight.inverse.objective.lit_faces import Level
from skylight.inverse.sky.solver import SolverOptions

QUICK = EstimateOptions(
    solver=SolverOptions(
        rounds=(
            Round(level=Level(3), starts=3, iterations=6),
            Round(level=Level(0), starts=1, iterations=2),
        )
    )
)
