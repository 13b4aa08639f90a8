from ._cluster import (
    Cluster as Cluster,
)
from ._device import (
    choose_device as choose_device,
)
from ._progress import (
    stage_bar as stage_bar,
)
from ._resumable import (
    results_folder as results_folder,
    share_work as share_work,
)
