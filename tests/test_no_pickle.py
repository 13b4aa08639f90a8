"""What a file says is data and never a program: nothing that runs what it reads is called."""

import ast
from collections.abc import Iterator

from tests.sources import PACKAGE, ROOT, parsed, python_files

MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
CALLS = {
    "eval", "exec", "compile", "torch.load", "torch.save", "yaml.load", "yaml.unsafe_load",
    "yaml.full_load", "pandas.read_pickle", "np.load", "numpy.load", "os.system",
    "dist.broadcast_object_list", "torch.hub.load",
}  # fmt: skip
# numpy's default refuses pickles; these read the package's own files or its own caches
OWN_ARRAYS = {
    "faces/_landmarks.py", "faces/_mediapipe.py", "faces/_model.py", "people/_skin.py",
    "training/_skies.py", "transport/_scene.py",
}  # fmt: skip


def test_nothing_runs_what_it_reads() -> None:
    found = {path: {*uses(parsed(path))} for path in python_files("skylight", "tools")}
    own = {*(ROOT / "tools").rglob("*.py"), *(PACKAGE / path for path in OWN_ARRAYS)}
    for path in own:
        found[path] -= {"np.load"}
    assert {str(path): names for path, names in found.items() if names} == {}


def uses(program: ast.Module) -> Iterator[str]:
    """The modules, calls and options in a program that could run what a file holds."""
    for node in ast.walk(program):
        if isinstance(node, ast.Import):
            yield from {name.name for name in node.names} & MODULES
        elif isinstance(node, ast.ImportFrom):
            yield from {node.module or ""} & MODULES
        elif isinstance(node, ast.Call):
            yield from {_dotted(node.func)} & CALLS
            for option in node.keywords:
                value = option.value
                if option.arg == "allow_pickle" and not (
                    isinstance(value, ast.Constant) and value.value is False
                ):
                    yield "allow_pickle"
                if option.arg == "shell" and getattr(value, "value", None) is not False:
                    yield "shell"


def _dotted(node: ast.expr) -> str:
    """``a.b.c``; what is no such name becomes a name that nothing has."""
    if isinstance(node, ast.Attribute):
        return f"{_dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def test_what_would_be_found() -> None:
    bad = "import pickle\nnp.load(f, allow_pickle=True)\ntorch.load(f)"
    assert {*uses(ast.parse(bad))} == {"pickle", "np.load", "allow_pickle", "torch.load"}
    fine = "model.eval()\nre.compile('a')\nnp.lib.format.read_array(f, allow_pickle=False)"
    assert not {*uses(ast.parse(fine))}
