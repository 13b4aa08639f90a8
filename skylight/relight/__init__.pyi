from ._decoder import (
    Latent as Latent,
    SkyDecoder as SkyDecoder,
    read_latent as read_latent,
)
from ._export import (
    export_decoder as export_decoder,
)
from ._runtime import (
    PrecomputedScene as PrecomputedScene,
    load_scene as load_scene,
    read_probe as read_probe,
    relight as relight,
    resize as resize,
    tone_map as tone_map,
)
