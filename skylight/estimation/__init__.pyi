from ._folder import (
    estimate_folder as estimate_folder,
)
from ._kept import (
    KeptFace as KeptFace,
    read_face as read_face,
)
from ._photos import (
    estimate as estimate,
    estimate_photo as estimate_photo,
)
from ._report import (
    write_results as write_results,
)
from ._settings import (
    EstimateSettings as EstimateSettings,
)
from ._summary import (
    PhotoEstimate as PhotoEstimate,
    SeenFace as SeenFace,
)
