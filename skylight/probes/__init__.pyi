from ._chart import (
    find_chart as find_chart,
    measure_ground as measure_ground,
)
from ._encoder import (
    ObjectEncoder as ObjectEncoder,
    SurfaceTransfer as SurfaceTransfer,
    choose_points as choose_points,
    surface_points as surface_points,
    surface_transfer as surface_transfer,
)
from ._probe_map import (
    ProbeMap as ProbeMap,
)
