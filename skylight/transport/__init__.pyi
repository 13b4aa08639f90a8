from ._background import (
    Background as Background,
)
from ._cameras import (
    Camera as Camera,
    PlacedCamera as PlacedCamera,
    read_object_camera as read_object_camera,
)
from ._interreflection import (
    BouncingMesh as BouncingMesh,
)
from ._matrix import (
    SurfaceRays as SurfaceRays,
    TransportMatrix as TransportMatrix,
    diffuse_transport as diffuse_transport,
    visibility as visibility,
)
from ._mesh import (
    read_mesh as read_mesh,
)
from ._normal_modes import (
    NormalModes as NormalModes,
)
from ._observation import (
    Observation as Observation,
)
from ._path_tracer import (
    DiffuseScene as DiffuseScene,
    Sampling as Sampling,
    radiosity_transfer as radiosity_transfer,
    shade as shade,
)
from ._rays import (
    OcclusionCaster as OcclusionCaster,
    Raycaster as Raycaster,
    TorchRaycaster as TorchRaycaster,
)
from ._reflection import (
    DiffuseTransport as DiffuseTransport,
    FrozenTransport as FrozenTransport,
    SkyTransport as SkyTransport,
    SpecularTransport as SpecularTransport,
    shade_scenes as shade_scenes,
)
from ._render import (
    rasterize as rasterize,
    render_diffuse as render_diffuse,
    vertex_normals as vertex_normals,
)
from ._scene import (
    EvaluationScene as EvaluationScene,
    evaluation_scene as evaluation_scene,
)
from ._visibility import (
    adaptive_visibility as adaptive_visibility,
)
