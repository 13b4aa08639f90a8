"""With which trained model, and on which device, the light of faces is estimated."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from skylight.inverse.estimate import estimate_light
from skylight.inverse.result import Estimate
from skylight.models.bundle import LightBundle, load_bundle
from skylight.models.names import LightName, is_trained
from skylight.transport.observation import Observation


@dataclass(frozen=True, kw_only=True)
class EstimateOptions:
    """``model`` is a trained model's folder, None for the one that comes with skylight."""

    model: Path | None = None
    device: str = "auto"

    def config(self) -> dict[str, object]:
        """What results depend on: the model's tensors."""
        return {} if self.model is None else {"model": _bundle(self.model).fingerprint}

    def estimate(
        self, observations: Observation | Sequence[Observation], light: LightName
    ) -> Estimate:
        """:func:`estimate_light`; harmonics have no trained model."""
        model = _bundle(self.model) if self.model is not None and is_trained(light) else None
        return estimate_light(observations, light, model=model, device=self.device)


@cache
def _bundle(folder: Path) -> LightBundle:
    return load_bundle(folder)
