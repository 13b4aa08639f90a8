from ._bounded import (
    json_content as json_content,
    write_json as write_json,
)
from ._files import (
    read_environment_map as read_environment_map,
    write_environment_map as write_environment_map,
    write_png as write_png,
)
from ._hdr import (
    write_exr as write_exr,
    write_radiance as write_radiance,
)
from ._light import (
    read_linear as read_linear,
)
from ._tensors import (
    read_tensors as read_tensors,
    write_tensors as write_tensors,
)
