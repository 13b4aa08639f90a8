from ._atmosphere import (
    Atmosphere as Atmosphere,
    ClearSky as ClearSky,
)
from ._captures import (
    Capture as Capture,
    index_captures as index_captures,
    index_folder as index_folder,
)
from ._clouds import (
    CloudLayer as CloudLayer,
)
from ._index import (
    SkyRecord as SkyRecord,
    divide as divide,
    load_skies as load_skies,
    read_index as read_index,
)
from ._simulated import (
    SimulationSettings as SimulationSettings,
    simulate_folder as simulate_folder,
    simulated_skies as simulated_skies,
)
from ._simulator import (
    SimulatedSky as SimulatedSky,
    draw_day as draw_day,
    simulate_sky as simulate_sky,
)
from ._sun import (
    Place as Place,
    find_sun as find_sun,
    sun_angles as sun_angles,
)
