from ._estimate import (
    FilmEstimate as FilmEstimate,
    FilmSettings as FilmSettings,
    estimate_film as estimate_film,
)
from ._kept import (
    KeptFilm as KeptFilm,
    read_film as read_film,
)
from ._light import (
    FilmLight as FilmLight,
)
from ._results import (
    write_film_results as write_film_results,
)
