from ._base import (
    LightModel as LightModel,
    ParametricLight as ParametricLight,
    Prior as Prior,
    without_azimuth as without_azimuth,
)
from ._bundle import (
    LightBundle as LightBundle,
    load_bundle as load_bundle,
    load_network as load_network,
    save_network as save_network,
)
from ._convolutional import (
    ConvolutionalAutoencoder as ConvolutionalAutoencoder,
)
from ._gaussians import (
    GaussianLobes as GaussianLobes,
)
from ._ground import (
    KnownGround as KnownGround,
    LambertianGround as LambertianGround,
    ground_prior as ground_prior,
)
from ._harmonic import (
    HarmonicLight as HarmonicLight,
)
from ._lamps import (
    LampsLight as LampsLight,
    LampsPrior as LampsPrior,
)
from ._network import (
    SkyNetwork as SkyNetwork,
)
from ._network_names import (
    register_network as register_network,
)
from ._prior import (
    GaussianMixture as GaussianMixture,
)
from ._sphere import (
    SphereLight as SphereLight,
    SpherePrior as SpherePrior,
)
from ._splines import (
    SplineAutoencoder as SplineAutoencoder,
)
from .autoencoder import (
    AutoencoderLight as AutoencoderLight,
)
from .sunsky import (
    SunSky as SunSky,
)
