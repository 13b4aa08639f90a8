from ._live import (
    Light as Light,
    LiveLight as LiveLight,
)
