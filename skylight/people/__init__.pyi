from ._files import (
    read_rendered_face as read_rendered_face,
    render_folder as render_folder,
    rendered_faces as rendered_faces,
    write_rendered_face as write_rendered_face,
)
from ._light import (
    RenderOptions as RenderOptions,
    SceneLight as SceneLight,
    scene_light as scene_light,
)
from ._people import (
    Person as Person,
    person as person,
)
from ._render import (
    RenderedFace as RenderedFace,
    photograph as photograph,
    render as render,
)
