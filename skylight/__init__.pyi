from .csc import (
    CodeSampler as CodeSampler,
    FilterBank as FilterBank,
    SphericalSparseCoder as SphericalSparseCoder,
)
from .errors import (
    SkylightError as SkylightError,
)
from .estimation import (
    PhotoEstimate as PhotoEstimate,
    estimate as estimate,
    estimate_photo as estimate_photo,
)
from .imaging import (
    CaptureMetadata as CaptureMetadata,
    Photo as Photo,
    read_photo as read_photo,
)
from .inverse import (
    Estimate as Estimate,
    estimate_each as estimate_each,
    estimate_light as estimate_light,
)
from .io import (
    read_environment_map as read_environment_map,
    write_environment_map as write_environment_map,
)
from .models import (
    AutoencoderLight as AutoencoderLight,
    HarmonicLight as HarmonicLight,
    KnownGround as KnownGround,
    LampsLight as LampsLight,
    SunSky as SunSky,
)
from .probes.partitions import (
    PartitionProbe as PartitionProbe,
)
from .probes.voxel import (
    VoxelProbe as VoxelProbe,
)
from .sphere import (
    DirectionGrid as DirectionGrid,
    EnvironmentMap as EnvironmentMap,
)
from .transport import (
    DiffuseTransport as DiffuseTransport,
    TransportMatrix as TransportMatrix,
)

__version__: str
