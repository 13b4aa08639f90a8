"""Light from rendered faces, where the true light is known (thesis, 5.5.3 and Table 5.2)."""

import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from skylight.evaluation.pictures import beside, strip
from skylight.evaluation.run import Check, Item
from skylight.evaluation.scores import score
from skylight.faces.fit import FaceFit, fit_face
from skylight.faces.landmarks import default_landmarker
from skylight.faces.model import HeadModel
from skylight.faces.observe import observe_face
from skylight.faces.synthetic import SyntheticFace, render_face
from skylight.imaging.files import write_png
from skylight.inverse.photo import estimate_light
from skylight.models.ground import GROUND_ALBEDOS
from skylight.models.shipped import LightName
from skylight.skies.simulated import simulated_skies
from skylight.sphere.envmap import EnvironmentMap

METHODS: tuple[LightName, ...] = ("sh9", "sh25", "sunsky", "autoencoder")
FITTED = "_fitted"  # rows with geometry from landmarks; those without have the true geometry
LOWEST_TRANSMITTANCE = 0.5  # the sun is visible
_SEEDS_APART = 1000  # so that each face finds a day of its own


@dataclass(frozen=True, kw_only=True)
class SyntheticFaces:
    """``count`` people under test skies with a visible sun, each with both geometries."""

    count: int
    size: int = 256
    seed: int = 20_000_000
    methods: tuple[LightName, ...] = METHODS
    name: str = "synthetic-faces"

    def config(self) -> dict[str, object]:
        return {"size": self.size, "seed": self.seed, "methods": list(self.methods)}

    def items(self) -> list[str]:
        return [f"face{i:04d}" for i in range(self.count)]

    def measure(self, item: str, picture: Path) -> Item:
        number = int(item.removeprefix("face"))
        face = synthetic_face(self.seed + _SEEDS_APART * number, self.size)
        model = HeadModel.load()
        metrics, environments = self._estimates(face, face.truth, "")
        facts: dict[str, object] = {"found": False}
        faces = default_landmarker().detect(face.encoded)
        if faces:
            fit = fit_face(model, faces[0], self.size, self.size)
            pose = pose_error_deg(fit, face.truth)
            fitted, fitted_environments = self._estimates(face, fit, FITTED)
            metrics |= {m: row | {"pose_deg": pose} for m, row in fitted.items()}
            environments |= fitted_environments
            facts = {"found": True, "landmark_error": fit.landmark_error, "pose_deg": pose}
        write_png(picture, beside(face.encoded, strip(face.environment, environments), item))
        problem = "" if faces else "no face found by the landmark detector"
        return Item(name=item, metrics=metrics, facts=facts, problem=problem)

    def _estimates(
        self, face: SyntheticFace, fit: FaceFit, suffix: str
    ) -> tuple[dict[str, dict[str, float]], dict[str, EnvironmentMap]]:
        """Metrics and environments by method; all methods share one transport."""
        start = time.perf_counter()
        view = observe_face(face.picture, face.clipped, HeadModel.load(), fit)
        transport_seconds = time.perf_counter() - start
        metrics, environments = {}, {}
        for method in self.methods:
            start, cpu_start = time.perf_counter(), time.process_time()
            estimate = estimate_light(view.observation, method)
            seconds, cpu = time.perf_counter() - start, time.process_time() - cpu_start
            scores = score(estimate.environment, face.environment, sun_visible=True)
            times = {
                "seconds": seconds,
                "cpu_seconds": cpu,
                "transport_seconds": transport_seconds,
            }
            metrics[method + suffix] = scores | times
            environments[method + suffix] = estimate.environment
        return metrics, environments

    def checks(
        self, rows: dict[str, dict[str, dict[str, float]]], items: list[Item]
    ) -> dict[str, Check]:
        checks: dict[str, Check] = {}
        for suffix, angle in (("", 3.0), (FITTED, 8.0)):
            ours = rows.get("autoencoder" + suffix)
            if ours is None:
                continue
            median = ours["sun_angle_deg"]["median"]
            checks[f"autoencoder{suffix} median sun angle (deg)"] = Check.at_most(median, angle)
            for metric in ("sun_dw_mae", "full_dw_mae"):
                for other in (m for m in ("sh9", "sh25") if m in self.methods):
                    theirs = rows[other + suffix][metric]["mean"]
                    checks[f"autoencoder{suffix} {metric} below {other}"] = Check.below(
                        ours[metric]["mean"], theirs, other + suffix
                    )
            if suffix:
                pose = ours["pose_deg"]["median"]
                checks["median pose error (deg)"] = Check.at_most(pose, 4.0)
        return checks


def synthetic_face(seed: int, size: int) -> SyntheticFace:
    """A person under the first sunny sky found from ``seed`` on, over one of nine grounds."""
    ((_, sky),) = simulated_skies(1, first_seed=seed, lowest_transmittance=LOWEST_TRANSMITTANCE)
    albedo = GROUND_ALBEDOS[np.random.default_rng(seed).integers(len(GROUND_ALBEDOS))]
    return render_face(sky, torch.tensor(albedo), seed=seed, size=size)


def pose_error_deg(fit: FaceFit, truth: FaceFit) -> float:
    """Angle of the rotation R_fit^T R_true."""
    cosine = (np.trace(fit.rotation.T @ truth.rotation) - 1) / 2
    return math.degrees(math.acos(float(np.clip(cosine, -1, 1))))
