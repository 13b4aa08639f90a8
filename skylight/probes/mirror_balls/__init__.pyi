from ._files import (
    merge_probe as merge_probe,
)
from ._merged import (
    BallOptions as BallOptions,
    MergedProbe as MergedProbe,
    merged_from_360 as merged_from_360,
    merged_from_ball as merged_from_ball,
)
