"""What is fuzzed: one module a reader, or a family of readers that tell their files apart.

``seeds()`` makes small valid files; ``read(content)`` has ``content`` read as such a file, and
returns or raises a :class:`~skylight.errors.SkylightError`. Everything else is a finding.
"""

NAMES = (
    "exr",
    "hdr",
    "maps",
    "photo",
    "code",
    "records",
    "vox",
    "npz",
    "mesh",
    "tensors",
    "onnx",
    "bundle",
    "mp4",
    "film",
    "raw",
    "glb",
    "estimate",
    "notes",
    "blender",
    "studio",
)
