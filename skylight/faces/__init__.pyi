from ._captures import (
    FaceCapture as FaceCapture,
    read_captures as read_captures,
)
from ._fit import (
    FaceFit as FaceFit,
    fit_face as fit_face,
)
from ._landmarkers import (
    DlibLandmarker as DlibLandmarker,
    choose_landmarker as choose_landmarker,
)
from ._landmarks import (
    DetectedFace as DetectedFace,
    FaceLandmarker as FaceLandmarker,
)
from ._mediapipe import (
    MediaPipeLandmarker as MediaPipeLandmarker,
)
from ._model import (
    HeadModel as HeadModel,
)
from ._observe import (
    FaceView as FaceView,
    observe_face as observe_face,
)
from ._skin import (
    SkinPrior as SkinPrior,
)
from ._synthetic import (
    SyntheticFace as SyntheticFace,
    render_face as render_face,
)
