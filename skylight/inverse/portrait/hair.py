"""Hair as a shell over a fitted head.

The head model is bald. Where a photograph shows hair on scalp or forehead, its triangles are
repeated :data:`THICKNESS_M` farther out, so that hair hides the light from the skin below it and is
shaded as the round thing that it is. Thickness, locks and strands are not those of the person.
"""

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from torch import Tensor
from torch.nn.functional import normalize

from skylight.faces.fit import FaceFit
from skylight.faces.model import HeadModel, Region
from skylight.transport.gbuffer import vertex_normals
from skylight.transport.raycast import Raycaster

THICKNESS_M = 0.011  # as that of the rendered people, 6 to 16 mm; longer hair stands off farther


def hair_shell(
    fit: FaceFit, hair: Float[ndarray, "h w"]
) -> tuple[Float[ndarray, "n 3"], Int[ndarray, "f 3"]]:
    """Vertices (metres, the camera's frame) and triangles, counter-clockwise from outside.

    ``hair`` is how likely a pixel of the photograph shows hair. It stands where that is more than a
    half at what the picture shows of scalp and forehead. The scalp that it does not show is as
    hairy as what it shows in the mean. Both arrays are empty of a bald head.
    """
    model = HeadModel.load()
    vertices, faces = torch.from_numpy(fit.vertices), torch.from_numpy(model.faces.copy())
    normals = vertex_normals(vertices, faces)
    scalp = model.regions == Region.SCALP
    height = model.mean[:, 1]
    brows = height[model.regions == Region.BROW].max()
    forehead = (model.regions == Region.FACE) & (height > brows)
    places = fit.camera.project(vertices).numpy().astype(np.float32)
    inside = ((places >= 0) & (places < (fit.camera.width, fit.camera.height))).all(1)
    seen = inside & _faces_camera(vertices, normals, Raycaster(vertices, faces))
    x, y = (places[:, None, k] - 0.5 for k in (0, 1))  # of cv2's pixels, whose centres are whole
    likely = cv2.remap(
        hair.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )[:, 0]
    hidden = scalp & ~seen
    likely[hidden] = likely[scalp & seen].mean() if (scalp & seen).any() else 0
    hairy = (likely > 0.5) & (hidden | seen & (scalp | forehead))
    kept, shell = np.unique(model.faces[hairy[model.faces].all(1)], return_inverse=True)
    return fit.vertices[kept] + THICKNESS_M * normals[kept].numpy(), shell.reshape(-1, 3)


def _faces_camera(
    vertices: Float[Tensor, "n 3"], normals: Float[Tensor, "n 3"], raycaster: Raycaster
) -> Bool[ndarray, " n"]:
    """Which vertices the camera at the origin sees, in the picture or beside it."""
    towards = normalize(-vertices, dim=1)
    starts = vertices + raycaster.epsilon * normals
    hidden = raycaster.occluded(starts.float(), towards.float())
    return (((normals * towards).sum(1) > 0) & ~hidden).numpy()
