from ._main import (
    evaluate as evaluate,
    evaluate_all as evaluate_all,
)
from ._run import (
    Evaluation as Evaluation,
)
