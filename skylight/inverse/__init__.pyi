from ._estimate import (
    estimate_each as estimate_each,
    estimate_light as estimate_light,
)
from ._faces import (
    ObjectiveWeights as ObjectiveWeights,
)
from ._harmonic import (
    NonNegativeHarmonics as NonNegativeHarmonics,
    nonnegative_harmonics as nonnegative_harmonics,
)
from ._lamp_relighting import (
    FaceTransport as FaceTransport,
    LampLight as LampLight,
)
from ._lbfgs import (
    minimise as minimise,
)
from ._least_squares import (
    nnls as nnls,
)
from ._posterior import (
    SunPosterior as SunPosterior,
)
from ._result import (
    Choice as Choice,
    Estimate as Estimate,
    FaceLight as FaceLight,
    Lamp as Lamp,
)
from ._scores import (
    angular_error_deg as angular_error_deg,
    find_lamps as find_lamps,
    render_spheres as render_spheres,
    score_maps as score_maps,
)
from ._sky import (
    SolverOptions as SolverOptions,
)
from ._sun_prior import (
    SunPrior as SunPrior,
    sun_prior as sun_prior,
)
from ._verdict import (
    Certainty as Certainty,
    Spreads as Spreads,
    Verdict as Verdict,
)
