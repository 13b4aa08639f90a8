from ._checks import (
    check_print as check_print,
)
from ._files import (
    write_3mf as write_3mf,
    write_stl as write_stl,
)
from ._mount import (
    MarkerBoard as MarkerBoard,
    Mount as Mount,
    Pole as Pole,
    make_mount as make_mount,
)
from ._parts import (
    BedLayout as BedLayout,
    PrintedPart as PrintedPart,
    PrintSizes as PrintSizes,
    lay_out as lay_out,
)
