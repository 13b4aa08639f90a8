from ._code import (
    CodeTensors as CodeTensors,
    SparseCode as SparseCode,
)
from ._coder import (
    SphericalSparseCoder as SphericalSparseCoder,
)
from ._compressed_transport import (
    CompressedTransport as CompressedTransport,
)
from ._dictionary import (
    FilterBank as FilterBank,
    anisotropic as anisotropic,
    builtin as builtin,
    isotropic as isotropic,
    load_dictionary as load_dictionary,
)
from ._gaussian_lobes import (
    GaussianLobes as GaussianLobes,
    fitted_lobes as fitted_lobes,
)
from ._greedy import (
    Pursuit as Pursuit,
    PursuitOptions as PursuitOptions,
    Support as Support,
    exchange as exchange,
    pursue as pursue,
)
from ._learning import (
    CapFilterBank as CapFilterBank,
    learn_patches as learn_patches,
)
from ._sampling import (
    CodeSampler as CodeSampler,
)
from ._sub_dictionaries import (
    BoxDictionary as BoxDictionary,
    SubDictionary as SubDictionary,
    multiresolution as multiresolution,
)
from ._wigner import (
    RotationCorrelation as RotationCorrelation,
    ZonalCorrelation as ZonalCorrelation,
    rotated_filters as rotated_filters,
)
