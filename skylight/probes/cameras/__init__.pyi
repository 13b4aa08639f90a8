from ._board import (
    Board as Board,
    ProbeAssembly as ProbeAssembly,
    load_board as load_board,
)
from ._calibrate import (
    Calibration as Calibration,
    calibrate as calibrate,
)
from ._exposures import (
    Exposure as Exposure,
    ExposureSeries as ExposureSeries,
    Merged as Merged,
    merge as merge,
)
from ._intrinsics import (
    Intrinsics as Intrinsics,
    load_intrinsics as load_intrinsics,
    save_intrinsics as save_intrinsics,
)
from ._pose import (
    BoardPose as BoardPose,
    board_pose as board_pose,
    find_corners as find_corners,
)
from ._response import (
    Response as Response,
    load_response as load_response,
    recover_response as recover_response,
)
from ._tracking import (
    BoardTracker as BoardTracker,
)
