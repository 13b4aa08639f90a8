from ._camera_turns import (
    turn_between as turn_between,
    world_from_cameras as world_from_cameras,
)
from ._capture_metadata import (
    CaptureMetadata as CaptureMetadata,
)
from ._colour import (
    linear_to_srgb as linear_to_srgb,
    srgb_to_linear as srgb_to_linear,
    tone_map as tone_map,
)
from ._exposure import (
    CameraExposure as CameraExposure,
)
from ._film import (
    FilmFrame as FilmFrame,
    film_frames as film_frames,
    film_rate as film_rate,
)
from ._metrics import (
    full_dw_mae as full_dw_mae,
    lighting_metrics as lighting_metrics,
    mae as mae,
    rmse as rmse,
    shading_metrics as shading_metrics,
    si_rmse as si_rmse,
    sky_dw_mae as sky_dw_mae,
    ssim as ssim,
    sun_angle_deg as sun_angle_deg,
    sun_dw_mae as sun_dw_mae,
)
from ._photo import (
    Photo as Photo,
    photo_from_codes as photo_from_codes,
    read_photo as read_photo,
)
