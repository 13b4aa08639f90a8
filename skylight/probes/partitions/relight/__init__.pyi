from ._composite import (
    Relighting as Relighting,
    TurningRelighting as TurningRelighting,
)
from ._live import (
    PartitionLiveView as PartitionLiveView,
)
from ._scene import (
    Scene as Scene,
    read_scene as read_scene,
)
from ._transfer import (
    TransferCoefficients as TransferCoefficients,
    TransferSampling as TransferSampling,
    transfer_coefficients as transfer_coefficients,
)
