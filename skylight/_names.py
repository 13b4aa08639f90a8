"""Names that the command line takes as choices, each beside the module that it belongs to.

They stand by themselves so that parsing a command imports no torch.
"""

from typing import Literal, get_args

# How a sphere is drawn on a plane: skylight.sphere._projections
Projection = Literal["latlong", "cube", "octahedral", "angular", "mirrorball"]
# Where the columns of a lat-long map look: skylight.sphere._frame
Convention = Literal["skylight", "openexr", "mitsuba", "threejs", "blender", "unity"]
# Signs, order and scale of nine spherical harmonics: skylight.sphere._harmonics
HarmonicConvention = Literal["skylight", "threejs", "arcore", "arkit", "gltf"]

# Dictionaries that come with the package: skylight.csc._dictionary
BuiltinName = Literal["iso", "ani", "vmf", "box"]
# Weights of either sign with a weak L1 norm, none below 0, or plain least squares:
# skylight.csc._greedy
Sign = Literal["l1", "nonnegative", "free"]

# By what the faces of a photograph, their landmarks and heads are chosen: skylight.faces
LandmarkerName = Literal["mediapipe", "dlib"]
WhichFaces = int | Literal["all"]  # counted from 1, the largest
HeadName = Literal["fitted", "deformed"]

# Lights that known objects are explained by, sparse codes of a dictionary, spherical harmonics, or
# lamps in ambient light: skylight.object._problem
ObjectLightName = Literal["ani", "iso", "vmf", "sh9", "sh25", "sh49", "lamps"]
OBJECT_LIGHTS: tuple[ObjectLightName, ...] = get_args(ObjectLightName)

# Paper that marker boards are printed on: skylight.probes.cameras._board
Page = Literal["A4", "A3", "letter"]
# What is photographed to merge a light probe: skylight.probes.mirror_balls._merged
MergedFrom = Literal["ball", "360"]

# Programs for which light is exported: skylight.maps._export
LightTarget = Literal["threejs", "sh", "ar", "gltf", "usd", "mitsuba", "blender"]
