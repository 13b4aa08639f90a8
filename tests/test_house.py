"""Rules about the code itself: what is there is used, and folders stay small."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "skylight"
USERS = ("skylight", "tools", "docs", "examples")
MOST_MODULES = 15  # in one folder, __init__.py not counted
REGISTERS = {"command", "get", "post", "put", "delete", "middleware", "exception_handler"}
ALLOWED = {
    "forward",  # called by torch
    "_check_input_dim",
    "GlossyTransport",  # for users' own programs, in the API reference
    "compress",
    "ObjectEncoder",
    "choose_points",
    "surface_points",
    "surface_transfer",
    "pdf",
    "dual_basis",
    "transport_matrix",
}


def test_no_folder_is_crowded() -> None:
    folders = [PACKAGE, *(path for path in PACKAGE.rglob("*") if path.is_dir())]
    counts = {
        str(folder.relative_to(ROOT)): sum(p.name != "__init__.py" for p in folder.glob("*.py"))
        for folder in folders
    }
    assert {folder: n for folder, n in counts.items() if n > MOST_MODULES} == {}


def test_nothing_is_used_by_tests_alone() -> None:
    """Each function, class, method and constant is named in code that is itself used.

    By name, wherever it is: what shares its name with something else that is used passes.
    """
    assert sorted(unused()) == []


def unused() -> Iterator[str]:
    definitions: dict[ast.AST, tuple[str, str]] = {}  # node: its name, where it is
    uses: dict[str, list[set[ast.AST]]] = defaultdict(list)  # name: definitions around each use
    files = [path for folder in USERS for path in sorted((ROOT / folder).rglob("*.py"))]
    for path in [*files, ROOT / "train.py"]:
        inside = path.is_relative_to(PACKAGE)
        for node, around in _nodes(ast.parse(path.read_text()), frozenset()):
            if inside and (name := _defined(node, around)):
                definitions[node] = name, f"{path.relative_to(ROOT)}:{node.lineno}"
            for name in _used(node):
                uses[name].append({*around})
    dead: set[ast.AST] = set()
    while found := {
        node
        for node, (name, _) in definitions.items()
        if node not in dead and all(around & {*dead, node} for around in uses[name])
    }:
        dead |= found
    for node in dead:
        name, where = definitions[node]
        yield f"{where} {name}"


def _nodes(node: ast.AST, around: frozenset[ast.AST]) -> Iterator[tuple[ast.AST, frozenset]]:
    """All nodes below one, each with the functions and classes that it is in."""
    for child in ast.iter_child_nodes(node):
        yield child, around
        defines = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        yield from _nodes(child, around | {child} if defines else around)


def _defined(node: ast.AST, around: frozenset[ast.AST]) -> str | None:
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
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
