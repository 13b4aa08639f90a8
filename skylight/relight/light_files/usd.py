"""USD: a DomeLight with its lat-long texture."""

from pathlib import Path

from skylight.io.atomic import atomic_path
from skylight.io.files import write_environment_map
from skylight.sphere.envmap import EnvironmentMap

LAYER, TEXTURE = "light.usda", "usd_light.exr"
# UsdLux, DomeLight: "The dome's default orientation is such that its top pole is aligned with the
# world's +Y axis. This adheres to the OpenEXR specification for latitude-longitude maps." What a
# pixel means is radiance times inputs:intensity, in the scene's linear Rec.709.
_LAYER = f"""#usda 1.0
(
    defaultPrim = "Light"
    doc = "Light by skylight: right-handed, +Y up, the camera of the picture looked along -Z"
    metersPerUnit = 1
    upAxis = "Y"
)

def DomeLight "Light"
{{
    float inputs:intensity = 1
    asset inputs:texture:file = @./{TEXTURE}@
    token inputs:texture:format = "latlong"
}}
"""


def write_usd(folder: Path, environment: EnvironmentMap) -> list[str]:
    """light.usda and usd_light.exr, which lies beside it and is turned the way OpenEXR says."""
    write_environment_map(folder / TEXTURE, environment, convention="openexr")
    with atomic_path(folder / LAYER) as temporary:
        temporary.write_text(_LAYER, encoding="utf-8")
    return [LAYER, TEXTURE]
