from ._analysis import (
    ProbeReport as ProbeReport,
    design_probe as design_probe,
    inspect as inspect,
)
from ._capture_files import (
    capture_voxel_probe as capture_voxel_probe,
)
from ._interreflection import (
    GlobalReconstruction as GlobalReconstruction,
)
from ._lightmap import (
    Lightmap as Lightmap,
    load_lightmap as load_lightmap,
)
from ._model import (
    VoxelModel as VoxelModel,
    read_voxels as read_voxels,
    star_probe as star_probe,
    voxelise as voxelise,
    write_voxels as write_voxels,
)
from ._printing import (
    PrintedProbe as PrintedProbe,
    print_voxel_probe as print_voxel_probe,
)
from ._probe import (
    VoxelProbe as VoxelProbe,
)
from ._reconstruct import (
    DirectReconstruction as DirectReconstruction,
)
from ._render_files import (
    render_voxels as render_voxels,
)
