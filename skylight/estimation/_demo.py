"""A demonstration without data: a rendered face in known light, and two photographs.

The photographs come with scikit-image.
"""

from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import UInt8
from numpy import ndarray

from skylight._figures import (
    INK,
    MUTED,
    STYLE,
    relit,
    save,
    show,
    show_probe,
    white_of,
    write_numbers,
)
from skylight.estimation._examples import EXAMPLES
from skylight.estimation._photos import estimate_photo
from skylight.estimation._report import write_results
from skylight.estimation._summary import PhotoEstimate
from skylight.faces._synthetic import SyntheticFace, render_face
from skylight.imaging._metrics import lighting_metrics, shading_metrics
from skylight.io._bounded import write_json
from skylight.io._files import write_png
from skylight.skies._simulated import simulated_skies
from skylight.sphere._envmap import EnvironmentMap
from skylight.transport._scene import evaluation_scene
from skylight.work._progress import StageProgress
from skylight.work._resumable import results_folder

# A day with a seed for evaluation, which no model was trained on, with the sun out; and a turn
# that puts the sun to the left behind the camera, where it lights the face from the side.
SKY_SEED, FACE_SEED, PHOTO_SIZE = 5001, 4, 320
SUN_TURN_RAD = -2.2
GROUND_ALBEDO = (0.22, 0.21, 0.18)


@dataclass(frozen=True, kw_only=True)
class Demonstration:
    """Folders of the estimates, and the first one's scores against the truth.

    ``photographs`` are of ``EXAMPLES``, in that order.
    """

    synthetic: Path
    photographs: tuple[Path, ...]
    scores: dict[str, float]


def demonstrate(out: Path, progress: StageProgress) -> Demonstration:
    """Estimate the rendered face and the examples into subfolders of ``out``."""
    synthetic = out / "synthetic"
    with results_folder(synthetic) as folder:
        progress("rendering a face", 0.0)
        (_, sky), *_ = simulated_skies(1, first_seed=SKY_SEED, lowest_transmittance=0.8)
        truth = render_face(
            sky,
            torch.tensor(GROUND_ALBEDO),
            seed=FACE_SEED,
            size=PHOTO_SIZE,
            azimuth_rad=SUN_TURN_RAD,
        )
        write_png(folder / "photo.png", truth.encoded)
        result = _estimate(folder, truth.encoded, "rendered face", progress)
        scores = score(result.estimate.environment, truth.environment)
        write_json(folder / "scores.json", scores)
        write_comparison(folder / "comparison.png", truth, result, scores)
    photographs = estimate_examples(out, progress)
    return Demonstration(synthetic=synthetic, photographs=photographs, scores=scores)


def estimate_examples(out: Path, progress: StageProgress) -> tuple[Path, ...]:
    """Estimate ``EXAMPLES``, each into the subfolder of its name; those folders."""
    for example in EXAMPLES:
        with results_folder(out / example.name) as folder:
            codes = example.codes()
            write_png(folder / "photo.png", codes)
            _estimate(folder, codes, f"{example.name} ({example.author})", progress)
    return tuple(out / example.name for example in EXAMPLES)


def score(estimated: EnvironmentMap, true: EnvironmentMap) -> dict[str, float]:
    """All scores: of the maps on the true one's rows, and of the evaluation scene's diffuse shading
    in their light."""
    estimated = estimated.resize(true.layout[0])
    scene = evaluation_scene()
    mask = scene.diffuse.image(torch.ones(len(scene.diffuse), 1))[..., 0] > 0
    shading = shading_metrics(scene.relight(estimated), scene.relight(true), mask)
    return {**lighting_metrics(estimated, true), **shading}


def write_comparison(
    path: Path, truth: SyntheticFace, result: PhotoEstimate, scores: dict[str, float]
) -> None:
    """True light above, estimated light below, in the same exposure; scores beside them."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    scene = evaluation_scene(144, 32)
    estimated, true = result.estimate.environment, truth.environment
    strength = float(scene.shade(estimated).mean() / scene.shade(true).mean())
    maps = {
        "True": true,
        "Estimated": EnvironmentMap(radiance=estimated.radiance / strength),
    }
    note = f"the estimate is shown as strong as the truth; it shades {strength:.2f} times as bright"
    white = white_of(true.upper().flat)
    with rc_context(STYLE):
        figure = Figure(figsize=(16, 8), dpi=120, facecolor="white")
        figure.text(
            0.02,
            0.95,
            "Known light, and what the face tells of it",
            fontsize=17,
            fontweight="bold",
            color=INK,
        )
        grid = figure.add_gridspec(
            2,
            4,
            width_ratios=(1, 2, 1.33, 1.33),
            left=0.02,
            right=0.98,
            top=0.87,
            bottom=0.06,
            wspace=0.06,
            hspace=0.22,
        )
        show(figure.add_subplot(grid[0, 0]), truth.encoded, "Rendered photograph")
        write_numbers(
            figure.add_subplot(grid[1, 0]),
            "Scores",
            [(name.replace("_", " "), f"{value:.3f}") for name, value in scores.items()],
            pitch=0.1,
        )
        for row, (name, environment) in enumerate(maps.items()):
            show_probe(figure.add_subplot(grid[row, 1]), environment, f"{name} light", white=white)
            diffuse, metal = relit(scene, environment, like=true)
            show(
                figure.add_subplot(grid[row, 2]), diffuse, f"Diffuse objects, {name.lower()} light"
            )
            show(figure.add_subplot(grid[row, 3]), metal, f"Metal objects, {name.lower()} light")
        figure.text(0.98, 0.955, note, ha="right", color=MUTED)
        save(figure, path)


def _estimate(
    folder: Path, codes: UInt8[ndarray, "h w 3"], title: str, progress: StageProgress
) -> PhotoEstimate:
    result = estimate_photo(codes, names=[title], progress=progress)
    progress("writing the results", 0.0)
    write_results(folder, result)
    return result
