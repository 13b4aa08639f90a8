"""With which trained model, effort and device the light of faces is estimated."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from skylight.evaluation.harness.trained_model import trained_model
from skylight.inverse.estimate import estimate_light
from skylight.inverse.result import Estimate
from skylight.inverse.sky.solver import SolverOptions
from skylight.models.names import LightName, is_trained
from skylight.transport.observation import Observation

_DEFAULT = SolverOptions()


@dataclass(frozen=True, kw_only=True)
class EstimateOptions:
    """``model`` is a trained model's folder, None for the one that comes with skylight.

    ``solver`` leaves parts of the objective out where its weights are 0, for ablations.
    """

    model: Path | None = None
    device: str = "auto"
    solver: SolverOptions = _DEFAULT

    def config(self) -> dict[str, object]:
        """What results depend on: the model's tensors, and a solver of other options."""
        config: dict[str, object] = {}
        if self.model is not None:
            config["model"] = trained_model(self.model).fingerprint
        if self.solver != _DEFAULT:
            config["solver"] = asdict(self.solver)
        return config

    def with_evidence(self) -> "EstimateOptions":
        """The same, so that skies can compete with lamps."""
        return replace(self, solver=replace(self.solver, evidence=True))

    def estimate(
        self, observations: Observation | Sequence[Observation], light: LightName
    ) -> Estimate:
        """:func:`estimate_light`; harmonics have no trained model."""
        model = trained_model(self.model) if self.model is not None and is_trained(light) else None
        return estimate_light(
            observations, light, model=model, options=self.solver, device=self.device
        )
