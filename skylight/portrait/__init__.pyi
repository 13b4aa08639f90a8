from ._files import (
    RelitPortrait as RelitPortrait,
    relit_portrait as relit_portrait,
    taken_apart as taken_apart,
    write_relit as write_relit,
)
from ._film import (
    relight_film as relight_film,
)
from ._keys import (
    KEYS as KEYS,
    key_light as key_light,
)
from ._lights import (
    NewLight as NewLight,
    light_of_map as light_of_map,
    light_with_sun_at as light_with_sun_at,
    rotated_light as rotated_light,
)
from ._relit import (
    Portrait as Portrait,
)
