from ._envmap import (
    EnvironmentMap as EnvironmentMap,
    averaged as averaged,
    luminance as luminance,
    shift_columns as shift_columns,
)
from ._frame import (
    DirectionGrid as DirectionGrid,
    angle_between as angle_between,
    angles_from_direction as angles_from_direction,
    convert_latlong as convert_latlong,
    direction_from_angles as direction_from_angles,
    pixel_from_direction as pixel_from_direction,
    rotation_about as rotation_about,
)
from ._harmonics import (
    bands as bands,
    convolve_zonal as convolve_zonal,
    degree_of as degree_of,
    evaluate as evaluate,
    project as project,
    to_convention as to_convention,
)
from ._latlong_transform import (
    LatLongTransform as LatLongTransform,
)
from ._lobes import (
    DiskSplines as DiskSplines,
    von_mises_fisher as von_mises_fisher,
)
from ._projections import (
    cube_faces as cube_faces,
    from_latlong as from_latlong,
    to_latlong as to_latlong,
)
from ._rotation import (
    RigidTransform as RigidTransform,
    euler_angles as euler_angles,
    matrix_from_euler as matrix_from_euler,
    rotate as rotate,
    rotation_blocks as rotation_blocks,
)
from ._wavelets import (
    cube_from_latlong as cube_from_latlong,
    haar as haar,
    inverse_haar as inverse_haar,
    latlong_from_cube as latlong_from_cube,
)
