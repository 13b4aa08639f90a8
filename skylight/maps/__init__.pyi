from ._convert import (
    convert_file as convert_file,
)
from ._export import (
    ExportedLight as ExportedLight,
    export_blender_scene as export_blender_scene,
    export_light as export_light,
)
from ._export_codes import (
    export_codes as export_codes,
)
from ._score import (
    ScoredMap as ScoredMap,
    score_files as score_files,
    score_folders as score_folders,
)
from ._sparse_codes import (
    CodedMap as CodedMap,
    code_map as code_map,
    decode_file as decode_file,
)
from ._viewer import (
    export_viewer as export_viewer,
)
