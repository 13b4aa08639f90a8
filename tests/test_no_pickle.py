"""What a file says is data and never a program: nothing that runs what it reads is called."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = [*(ROOT / "skylight").rglob("*.py"), *(ROOT / "tools").rglob("*.py"), ROOT / "train.py"]
MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
CALLS = {
    "eval", "exec", "compile", "torch.load", "torch.save", "yaml.load", "yaml.unsafe_load",
    "yaml.full_load", "pandas.read_pickle", "np.load", "numpy.load", "os.system",
    "dist.broadcast_object_list", "torch.hub.load",
}  # fmt: skip
# numpy's default refuses pickles; these read the package's own files or its own caches
OWN_ARRAYS = {
    "evaluation/rendered_faces/skin.py", "faces/landmarks.py", "faces/detection/mediapipe_face.py",
    "faces/model.py", "training/skies/data.py", "training/skies/prepared.py",
    "transport/scene/traced.py",
}  # fmt: skip


def uses(source: str) -> set[str]:
    """The modules, calls and options in a program that could run what a file holds."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names} & MODULES
        elif isinstance(node, ast.ImportFrom):
            found |= {node.module or ""} & MODULES
        elif isinstance(node, ast.Call):
            found |= {ast.unparse(node.func)} & CALLS
            for option in node.keywords:
                value = option.value
                if option.arg == "allow_pickle" and not (
                    isinstance(value, ast.Constant) and value.value is False
                ):
                    found.add("allow_pickle")
                if option.arg == "shell" and getattr(value, "value", None) is not False:
                    found.add("shell")
    return found


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_nothing_runs_what_it_reads(path: Path) -> None:
    found = uses(path.read_text(encoding="utf-8"))
    inside = path.relative_to(ROOT / "skylight") if "skylight" in path.parts else path
    if str(inside) in OWN_ARRAYS or path.is_relative_to(ROOT / "tools"):
        found -= {"np.load"}
    assert not found


def test_what_would_be_found() -> None:
    assert uses("import pickle\nnp.load(f, allow_pickle=True)\ntorch.load(f)") == {
        "pickle", "np.load", "allow_pickle", "torch.load",
    }  # fmt: skip
    assert uses(
        "model.eval()\nre.compile('a')\nnp.lib.format.read_array(f, allow_pickle=False)"
    ) == (set())
