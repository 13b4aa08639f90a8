"""Names of projections and conventions, which the command line takes as choices.

They stand by themselves so that parsing a command imports no torch.
"""

from typing import Literal

# How a sphere is drawn on a plane: skylight.sphere._projections
Projection = Literal["latlong", "cube", "octahedral", "angular", "mirrorball"]
# Where the columns of a lat-long map look: skylight.sphere._frame
Convention = Literal["skylight", "openexr", "mitsuba", "threejs", "blender", "unity"]
# Signs, order and scale of nine spherical harmonics: skylight.sphere._harmonics
HarmonicConvention = Literal["skylight", "threejs", "arcore", "arkit", "gltf"]
