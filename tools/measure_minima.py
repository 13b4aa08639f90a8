"""How many starts of an estimate reach its best minimum, by light model.

    skylight faces render --out faces --count 40
    python -m tools.measure_minima --faces faces --models FOLDER ...

A smooth light model has few minima. On each rendered face every start of the solver (towards the
directions of its scan, and from the mixture's centroids) is descended to its end on the coarsest
level, none being dropped on the way: L-BFGS, then Gauss-Newton steps. A start reaches the best
minimum where its objective J of Eq. 5.8 ends within one nat of the least; the share of those is
averaged over faces. Beside it: the share whose suns end within 5 degrees of that of the least.
Models are folders of bundles; the one that comes with skylight is measured with them.
"""

import argparse
import math
import time
from pathlib import Path

import torch

from skylight.evaluation._known_faces import fitted_head, read_face
from skylight.faces._model import HeadModel
from skylight.faces._observe import observe_face
from skylight.inverse._descent import Round, descend
from skylight.inverse._estimate import light_problems
from skylight.inverse._faces import Level
from skylight.inverse._scan import SunScan, scan_faces
from skylight.inverse._sky import SkyProblem, SolverOptions
from skylight.people._files import rendered_faces
from skylight.transport._observation import Observation
from tools.measured import write_measured

RESULTS = Path(__file__).parents[1] / "benchmarks" / "results"
EVERY = 1000  # more than there are starts
ROUNDS = (
    Round(level=Level(2), starts=EVERY, iterations=40, even_skin=True),
    Round(level=Level(2), starts=EVERY, iterations=30, even_skin=True, steps="broyden"),
)
SAME_NATS, SAME_SUN_DEG = 1.0, 5.0


def ends(observation: Observation, model: Path | None) -> dict[str, float]:
    """Shares of the starts of one face that end where the best one does."""
    (problem,) = light_problems("autoencoder", model=model, options=SolverOptions(rounds=ROUNDS))
    assert isinstance(problem, SkyProblem)
    problem.add(observation)
    solver, faces = problem.solver, problem.faces
    observed = [face.scanned for face in faces]
    scan = SunScan.of(scan_faces(observed), candidates=solver.options.scan_candidates)
    points = [solver.starts(faces, None, scan.candidates)]
    objective = solver.objective([faces], [None], ROUNDS[0])
    for effort in ROUNDS:
        points = descend(objective, points, effort, solver.options.tolerance)
    scores, light = points[0].scores, objective.unpack(points[0].free).light
    sun = solver.model.sun_direction(light)
    assert sun is not None
    best = scores.argmin()
    near = sun @ sun[best] > math.cos(math.radians(SAME_SUN_DEG))
    return {
        "starts": len(scores),
        "at_the_best": float((scores < scores[best] + SAME_NATS).float().mean()),
        "sun_of_the_best": float(near.float().mean()),
        "spread_nats": float(scores.median() - scores[best]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0] if __doc__ else "")
    parser.add_argument("--faces", type=Path, required=True)
    parser.add_argument("--models", type=Path, nargs="*", default=[])
    parser.add_argument("--count", type=int, default=40)
    told = parser.parse_args()
    begun = time.time()
    torch.set_num_threads(1)
    models: dict[str, Path | None] = {"shipped": None} | {m.name: m for m in told.models}
    found: dict[str, dict[str, dict[str, float]]] = {name: {} for name in models}
    for folder in rendered_faces(told.faces)[: told.count]:
        face = read_face(folder)
        fit = fitted_head(face, {})
        if fit is None:
            continue
        view = observe_face(face.picture, face.clipped, HeadModel.load(), fit)
        for name, model in models.items():
            found[name][folder.name] = ends(view.observation, model)
        print(folder.name, {n: f"{found[n][folder.name]['at_the_best']:.2f}" for n in models})
    means = {
        name: {
            metric: sum(each[metric] for each in rows.values()) / len(rows)
            for metric in ("starts", "at_the_best", "sun_of_the_best", "spread_nats")
        }
        for name, rows in found.items()
    }
    names = " ".join(model.name for model in told.models)
    write_measured(
        RESULTS / "minima.json",
        name="minima",
        what="share of an estimate's starts that reach the best minimum",
        command=f"python -m tools.measure_minima --faces faces --models {names} "
        f"--count {told.count}",
        begun=begun,
        facts={"faces": len(next(iter(found.values()))), "models": means, "items": found},
    )


if __name__ == "__main__":
    main()
