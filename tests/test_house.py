"""Rules about the code itself: modules are private and small, and what is there is used."""

import ast
from collections import defaultdict
from collections.abc import Iterator

from tests.sources import PACKAGE, ROOT, parsed, python_files

DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
USERS = ("skylight", "tools", "docs", "examples")
MOST_LINES = 600  # of a module
PUBLIC = {"cli.py", "errors.py", "models/autoencoder.py", "models/sunsky.py"}  # modules
REGISTERS = {"command", "get", "post", "put", "delete", "middleware", "exception_handler"}
ALLOWED = {
    "forward",  # called by torch, and so are the next four
    "_check_input_dim",
    "setup_context",
    "jvp",
    "vmap",
    "SpecularTransport",  # for users' own programs, in the API reference
    "compress",
    "pdf",
    "dual_basis",
    "transport_matrix",
}


def test_modules_are_private() -> None:
    """A package's ``__init__`` has its public names; all else may change."""
    paths = (path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py"))
    assert {str(path) for path in paths if not path.name.startswith("_")} == PUBLIC


def test_modules_are_small() -> None:
    lengths = {path: path.read_bytes().count(b"\n") for path in PACKAGE.rglob("*.py")}
    assert [str(path) for path, count in lengths.items() if count > MOST_LINES] == []


def test_nothing_is_used_by_tests_alone() -> None:
    """Each function, class, method and constant is named in code that is itself used.

    By name, wherever it is: what shares its name with something else that is used passes.
    """
    assert sorted(unused()) == []


def unused() -> Iterator[str]:
    definitions: dict[ast.AST, tuple[str, str]] = {}  # node: its name, where it is
    uses: dict[str, set[tuple[ast.AST, ...]]] = defaultdict(set)  # name: definitions around uses
    for path in python_files(*USERS):
        inside = path.is_relative_to(PACKAGE)
        for node, around in _nodes(parsed(path)):
            if inside and (name := _defined(node, around)):
                definitions[node] = name, f"{path.relative_to(ROOT)}:{node.lineno}"
            for name in _used(node):
                uses[name].add(around)
    for path in PACKAGE.rglob("__init__.pyi"):  # public names are for users' programs
        for node in ast.walk(ast.parse(path.read_text())):
            for alias in node.names if isinstance(node, ast.ImportFrom) else ():
                uses[alias.name].add(())
    dead: set[ast.AST] = set()
    while found := {
        node
        for node, (name, _) in definitions.items()
        if node not in dead and all(node in a or not dead.isdisjoint(a) for a in uses[name])
    }:
        dead |= found
    for node in dead:
        name, where = definitions[node]
        yield f"{where} {name}"


def _nodes(tree: ast.Module) -> Iterator[tuple[ast.AST, tuple[ast.AST, ...]]]:
    """All nodes of a file, each with the functions and classes that it is in."""
    left: list[tuple[ast.AST, tuple[ast.AST, ...]]] = [(tree, ())]
    while left:
        node, around = left.pop()
        yield node, around
        if isinstance(node, DEFINITIONS):
            around = (*around, node)
        left += [(child, around) for child in ast.iter_child_nodes(node)]


def _defined(node: ast.AST, around: tuple[ast.AST, ...]) -> str | None:
    if isinstance(node, DEFINITIONS):
        inner = any(not isinstance(each, ast.ClassDef) for each in around)
        registered = {
            each.attr
            for decorator in node.decorator_list
            for each in ast.walk(decorator)
            if isinstance(each, ast.Attribute)
        }
        name = node.name
        if inner or registered & REGISTERS:
            return None
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and not around:
        name = node.id
    else:
        return None
    return None if name.startswith("__") or name in ALLOWED else name


def _used(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
        yield node.id
    elif isinstance(node, ast.Attribute):
        yield node.attr
    elif isinstance(node, ast.Tuple | ast.Dict):  # ("skylight.module", "name"), and the reverse
        pairs = (
            zip(node.values, node.keys, strict=True) if isinstance(node, ast.Dict) else [node.elts]
        )
        texts = [[n.value for n in pair if isinstance(n, ast.Constant)] for pair in pairs]
        for text in texts:
            if len(text) == 2 and str(text[0]).startswith("skylight."):
                yield str(text[1])
