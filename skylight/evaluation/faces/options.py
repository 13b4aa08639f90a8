"""With which trained model, and on which device, the light of faces is estimated."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skylight.evaluation.harness.trained_model import trained_model
from skylight.inverse.estimate import estimate_light
from skylight.inverse.result import Estimate
from skylight.models.names import LightName, is_trained
from skylight.transport.observation import Observation


@dataclass(frozen=True, kw_only=True)
class EstimateOptions:
    """``model`` is a trained model's folder, None for the one that comes with skylight."""

    model: Path | None = None
    device: str = "auto"

    def config(self) -> dict[str, object]:
        """What results depend on: the model's tensors."""
        return {} if self.model is None else {"model": trained_model(self.model).fingerprint}

    def estimate(
        self, observations: Observation | Sequence[Observation], light: LightName
    ) -> Estimate:
        """:func:`estimate_light`; harmonics have no trained model."""
        model = trained_model(self.model) if self.model is not None and is_trained(light) else None
        return estimate_light(observations, light, model=model, device=self.device)
