"""What a process imports before it can work: nothing that is slow and not used."""

import subprocess
import sys

import pytest

# what takes a tenth of a second or more, and estimates do without
SLOW = ("matplotlib", "trimesh", "kornia", "networkx", "skimage", "pandas", "OpenImageIO", "dask")


def imported_by(code: str) -> set[str]:
    """The packages that a new process has imported after that code."""
    told = subprocess.run(
        [sys.executable, "-c", f"import sys\n{code}\nprint(*sys.modules, sep='\\n')"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    return {name.partition(".")[0] for name in told}


def test_an_estimate_and_its_report_import_nothing_slow():
    found = imported_by(
        "from skylight.estimation import _photos, _report\n"
        "from skylight.estimation._page import Page\n"
        "from skylight.transport._scene import evaluation_scene\n"
        "import io, pathlib, tempfile\n"
        "page = Page(200, 100)\n"
        "page.write(10.0, 50.0, 'light')\n"
        "with tempfile.TemporaryDirectory() as folder:\n"
        "    page.save(pathlib.Path(folder) / 'page.png')\n"
        "evaluation_scene(144, 32)"
    )
    assert "torch" in found
    assert not found & set(SLOW)


@pytest.mark.parametrize("code", ["import skylight", "import skylight.cli"])
def test_commands_are_known_without_torch(code):
    found = imported_by(code)
    assert "skylight" in found
    assert not found & {"torch", "scipy", "cv2", *SLOW}
