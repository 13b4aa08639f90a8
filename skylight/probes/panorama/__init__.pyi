from ._files import (
    Stitched as Stitched,
    stitch_probe as stitch_probe,
)
from ._panorama import (
    Panorama as Panorama,
    panorama_of as panorama_of,
)
