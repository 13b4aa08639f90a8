from ._capture_files import (
    capture_partition_probe as capture_partition_probe,
)
from ._captured import (
    ProbeCapture as ProbeCapture,
    load_capture as load_capture,
)
from ._cells import (
    Cells as Cells,
    Tessellation as Tessellation,
    voronoi as voronoi,
)
from ._optimise import (
    RelightingError as RelightingError,
    SearchSettings as SearchSettings,
    named_design as named_design,
    optimise_design as optimise_design,
)
from ._probe import (
    PartitionProbe as PartitionProbe,
)
from ._relight_files import (
    ScenePlacement as ScenePlacement,
    VirtualScene as VirtualScene,
    relight_scene as relight_scene,
)
from ._seeds import (
    ProbeDesign as ProbeDesign,
    load_design as load_design,
    save_design as save_design,
)
from ._sun_path import (
    simulated_lights as simulated_lights,
)
