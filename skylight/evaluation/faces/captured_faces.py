"""Illumination from photographs with captured light probes (thesis, 5.5.4, Table 5.3, Fig. 5.7)."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from skylight.errors import InputError
from skylight.evaluation.faces.face_light import METHODS, observe_largest
from skylight.evaluation.faces.options import EstimateOptions
from skylight.evaluation.harness.pictures import PROBE, SCENE, WIDTH, beside, caption, sized
from skylight.evaluation.harness.run import Check, Item
from skylight.evaluation.scores.relit_scene import score
from skylight.faces.captures import (
    CAPTURES_NAME,
    FaceCapture,
    capture_hash,
    read_captures,
    true_light,
)
from skylight.imaging.colour import tone_map
from skylight.imaging.photo import read_photo
from skylight.io.files import write_png
from skylight.models.names import LightName
from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.transport.scene.evaluation import evaluation_scene

OF_SCALE = ("brightness", "mae_aligned", "rmse_aligned")  # which is aligned before


@dataclass(frozen=True, kw_only=True)
class CapturedFaces:
    """The photographs of ``data/captures.csv``, each ``every``-th, against their probes.

    Photograph and probe come from different exposures, so brightness cannot be compared: every
    light is scaled to the true mean shading ("mapping the average image intensity to 1", thesis,
    5.5.1) before errors of shading are taken. What speaks of the sun is left out where the
    capture says that none was visible.
    """

    data: Path
    every: int = 1
    methods: tuple[LightName, ...] = METHODS
    seed: int = 0  # nothing is drawn
    options: EstimateOptions = EstimateOptions()
    name: str = "captured-faces"

    def __post_init__(self) -> None:
        unknown = [c.photo for c in self._captures().values() if c.azimuth_deg is None]
        if unknown:
            raise InputError(
                f"{self.data / CAPTURES_NAME}: {len(unknown)} of its photographs have no "
                f"azimuth_deg ({unknown[0]} is the first); find it by `skylight faces "
                f"calibrate-azimuth {self.data}`"
            )

    def config(self) -> dict[str, object]:
        digest = hashlib.sha256()
        for capture in self._captures().values():
            digest.update(f"{capture} {capture_hash(self.data, capture)}".encode())
        return {"captures": digest.hexdigest(), "methods": list(self.methods)} | (
            self.options.config()
        )

    def items(self) -> list[str]:
        return list(self._captures())[:: self.every]

    def measure(self, item: str, picture: Path) -> Item:
        capture = self._captures()[item]
        truth = true_light(self.data, capture)
        photo = read_photo(self.data / item, require_colour=True)
        fit, view = observe_largest(photo, str(self.data / item))
        found = {m: self.options.estimate(view.observation, m) for m in self.methods}
        environments = {m: estimate.environment for m, estimate in found.items()}
        picture.parent.mkdir(parents=True, exist_ok=True)  # photographs may lie in sub-folders
        seen = tone_map(view.image)
        write_png(picture, beside(seen, figure_columns(truth, environments), item))
        facts: dict[str, object] = {
            "person": capture.person,
            "visible_sun": capture.visible_sun,
            "azimuth_deg": capture.azimuth_deg,
            "landmark_error": fit.landmark_error,
        }
        return Item(
            name=item,
            metrics={m: aligned_scores(e, truth, capture) for m, e in environments.items()},
            facts=facts,
        )

    def checks(
        self, rows: dict[str, dict[str, dict[str, float]]], items: list[Item]
    ) -> dict[str, Check]:
        """In the thesis the autoencoder has the best shading and the best sun."""
        ours = rows.get("autoencoder", {})
        checks = {}
        for metric in ("si_rmse", "full_dw_mae", "sun_dw_mae"):
            for other in (m for m in ("sh9", "sh25") if metric in ours and m in rows):
                checks[f"autoencoder {metric} below {other}"] = Check.below(
                    ours[metric]["mean"], rows[other][metric]["mean"], other
                )
        return checks

    def _captures(self) -> dict[str, FaceCapture]:
        return {capture.photo: capture for capture in read_captures(self.data)}


def aligned_scores(
    estimate: EnvironmentMap, truth: EnvironmentMap, capture: FaceCapture
) -> dict[str, float]:
    """:func:`score` of the estimate scaled to the true mean shading, without what tells scale."""
    scene = evaluation_scene()
    factor = scene.shade(truth).mean() / scene.shade(estimate).mean().clamp(min=1e-12)
    scaled = EnvironmentMap(radiance=estimate.radiance * factor)
    scores = score(scaled, truth, sun_visible=capture.visible_sun)
    return {k: v for k, v in scores.items() if k not in OF_SCALE}


def figure_columns(
    truth: EnvironmentMap, estimates: dict[str, EnvironmentMap]
) -> UInt8[np.ndarray, "h w 3"]:
    """Fig. 5.7: truth first, then each method; matt things, the light, shining things.

    Each column is exposed for the same mean shading of the matt things.
    """
    scene = evaluation_scene()
    columns = []
    for name, environment in ({"truth": truth} | estimates).items():
        mean = float(luminance(scene.shade(environment)).mean())
        matt = tone_map(scene.relight(environment), white=2 * mean)
        light = tone_map(environment.radiance, white=3 * mean)
        glossy = tone_map(scene.relight_glossy(environment), white=3 * mean)
        rows = [sized(matt, WIDTH, SCENE), sized(light, WIDTH, PROBE), sized(glossy, WIDTH, SCENE)]
        columns.append(np.vstack([caption(name, WIDTH), *rows]))
    return np.hstack(columns)
