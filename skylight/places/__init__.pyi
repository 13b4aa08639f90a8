from ._simulated import (
    LightRecord as LightRecord,
    PlaceRecord as PlaceRecord,
    read_places as read_places,
    simulate_place as simulate_place,
    simulate_places as simulate_places,
)
from ._view import (
    DistinctLight as DistinctLight,
    Rendered as Rendered,
)
