from ._files import (
    KnownObjectEstimate as KnownObjectEstimate,
    estimate_known_object as estimate_known_object,
)
from ._lamps import (
    ObjectLamps as ObjectLamps,
)
from ._problem import (
    ObjectLight as ObjectLight,
    estimate_object_light as estimate_object_light,
)
from ._view import (
    ObjectMaterial as ObjectMaterial,
    ObjectView as ObjectView,
    observe_object as observe_object,
)
