"""The ways in which :mod:`tools.mutate` breaks a file, one place at a time."""

import ast
import copy
import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

COMPARISONS = {
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip
ARITHMETIC = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.Pow: ast.Mult,
    ast.LShift: ast.RShift, ast.RShift: ast.LShift,
}  # fmt: skip
OTHER_NAMES = {"max": "min", "any": "all", "argmax": "argmin", "amax": "amin", "sin": "cos"}
OTHER_NAMES |= {other: name for name, other in OTHER_NAMES.items()} | {"sorted": "list"}
LEFT_OUT = {"clamp", "abs", "sqrt", "square", "clip", "log", "exp", "round", "resize"}
# calls that draw or tell, and keywords that change nothing where all is well
SHOWN = {
    *("Figure", "plot", "bar", "set", "set_xlabel", "set_ylabel", "set_xscale", "set_title"),
    *("set_ylim", "legend", "grid", "axis", "caption", "save_figure", "sized", "captioned_rows"),
    *("tell", "report", "print", "strip", "beside", "write_png", "perf_counter", "process_time"),
    *("tone_map", "panorama_rows", "write_sheet", "picture_of", "subplots", "close", "debug"),
}
NO_MATTER = {"strict", "encoding", "parents", "exist_ok", "ignore_errors"}


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """``lines`` are those that run it, ``source`` the whole file with the change in it."""

    file: str
    lines: tuple[int, ...]
    in_function: bool
    kind: str
    old: str
    new: str
    source: bytes
    number: int

    @property
    def change(self) -> str:
        """For people, in a line."""
        old, new = (text if len(text) < 90 else f"{text[:87]}..." for text in (self.old, self.new))
        return f"{old}  ->  {self.kind if self.kind.startswith('without') else new}"

    @property
    def key(self) -> str:
        """Known again after changes elsewhere in the file; ``number`` counts equal ones."""
        parts = "\0".join((self.file, self.kind, self.old, self.new, str(self.number)))
        return hashlib.sha256(parts.encode()).hexdigest()[:16]


def mutants_of(root: Path, file: str) -> list[Mutant]:
    """All of a file, in its order."""
    text = (root / file).read_bytes()
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found: dict[bytes, Mutant] = {}
    seen: Counter[tuple[str, ...]] = Counter()
    for node, new, kind, lines, inside in _changes(ast.parse(text), (), inside=False):
        begin = starts[node.lineno - 1] + node.col_offset
        finish = starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
        written = ast.unparse(new)
        if isinstance(new, ast.expr) and not isinstance(new, ast.Name | ast.Constant | ast.Call):
            written = f"({written})"
        source = text[:begin] + written.encode() + text[finish:]
        old = " ".join(text[begin:finish].decode().split())
        if source not in found:
            found[source] = Mutant(
                file=file, lines=lines, in_function=inside, kind=kind, old=old, new=written,
                source=source, number=seen[kind, old, written],
            )  # fmt: skip
            seen[kind, old, written] += 1
    return list(found.values())


Change = tuple[ast.expr | ast.stmt, ast.AST, str, tuple[int, ...], bool]


def _changes(node: ast.AST, lines: tuple[int, ...], *, inside: bool) -> Iterator[Change]:
    if _is_left_alone(node):
        return
    if isinstance(node, ast.expr | ast.stmt):
        if isinstance(node, ast.stmt):
            last = node.lineno if hasattr(node, "body") else node.end_lineno or node.lineno
            lines = tuple(range(node.lineno, last + 1))
        else:
            lines = tuple(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        for kind, new in _broken(node):
            yield node, new, kind, lines, inside
        if isinstance(node, ast.If | ast.IfExp):
            for value in (True, False):
                yield node.test, ast.Constant(value), "condition", lines, inside
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "bases", "slice_type"):
            continue
        deeper = inside or (name == "body" and isinstance(node, ast.FunctionDef))
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from _changes(child, lines, inside=deeper)


def _is_left_alone(node: ast.AST) -> bool:
    """What is for people, and what no test is asked for."""
    if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr | ast.Import | ast.ImportFrom):
        return True
    if isinstance(node, ast.FunctionDef):
        returned = ast.unparse(node.returns) if node.returns else ""
        return "Picture" in returned or "UInt8" in returned or node.name.startswith("write_")
    if isinstance(node, ast.Assign):
        names = {ast.unparse(target) for target in node.targets}
        is_type = isinstance(node.value, ast.Subscript) and ast.unparse(node.value)[0].isupper()
        return "quick" in names or is_type or _called(node.value) in ("TypeVar", "re.compile")
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return True
    return _called(node).rpartition(".")[2] in SHOWN


def _called(node: ast.AST) -> str:
    while isinstance(node, ast.Expr | ast.Await):
        node = node.value
    return ast.unparse(node.func) if isinstance(node, ast.Call) else ""


def _broken(node: ast.expr | ast.stmt) -> Iterator[tuple[str, ast.AST]]:
    """(what was done, what stands in the node's place)."""
    match node:
        case ast.Compare(ops=[first, *_]) if type(first) in COMPARISONS:
            yield "comparison", _with(node, ops=[COMPARISONS[type(first)](), *node.ops[1:]])
        case ast.BinOp(left=left, op=op, right=right) if not _is_text(left):
            if type(op) in ARITHMETIC:
                yield "arithmetic", _with(node, op=ARITHMETIC[type(op)]())
            if isinstance(op, ast.Mult | ast.BitOr | ast.BitAnd | ast.Sub | ast.Add):
                yield "operand", left
            if isinstance(op, ast.Mult | ast.BitAnd):
                yield "operand", right
        case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert(), operand=operand):
            yield "negation", operand
        case ast.BoolOp(op=op):
            yield "and, or", _with(node, op=ast.Or() if isinstance(op, ast.And) else ast.And())
        case ast.Constant(value=bool(value)):
            yield "constant", ast.Constant(not value)
        case ast.Constant(value=int(value)):
            yield "constant", ast.Constant(value + 1)
        case ast.Constant(value=float(value)):
            yield "constant", ast.Constant(2 * value if value else 1.0)
        case ast.Call():
            yield from _calls(node)
        case ast.Dict(keys=[_, _, *_]):
            for i in range(len(node.keys)):
                keys, values = node.keys[:i] + node.keys[i + 1 :], node.values[:i]
                what = ast.unparse(node.keys[i] or node.values[i])[:60]
                rest = _with(node, keys=keys, values=values + node.values[i + 1 :])
                yield f"without {what}", rest
        case ast.List(elts=[_, _, *_], ctx=ast.Load()) | ast.Set(elts=[_, _, *_]):
            for i in range(len(node.elts)):
                what = " ".join(ast.unparse(node.elts[i]).split())[:60]
                yield f"without {what}", _with(node, elts=node.elts[:i] + node.elts[i + 1 :])
        case ast.ListComp(generators=[one]) | ast.GeneratorExp(generators=[one]) if one.ifs:
            kept = copy.copy(one)
            kept.ifs = []
            yield "condition", _with(node, generators=[kept])
        case ast.AugAssign(op=ast.Add() | ast.Sub() | ast.Mult() | ast.BitOr()):
            yield "statement", ast.Pass()
        case ast.Expr(value=ast.Call()):
            yield "statement", ast.Pass()
        case ast.Continue() | ast.Break():
            yield "statement", ast.Pass()


def _calls(node: ast.Call) -> Iterator[tuple[str, ast.AST]]:
    name = node.func.attr if isinstance(node.func, ast.Attribute) else ast.unparse(node.func)
    match node.args:
        case [first, second, *rest] if not isinstance(first, ast.Starred):
            if name not in ("isinstance", "getattr", "hasattr", "range", "partial"):
                yield "arguments", _with(node, args=[second, first, *rest])
    for i, keyword in enumerate(node.keywords):
        if keyword.arg and keyword.arg not in NO_MATTER:
            rest = node.keywords[:i] + node.keywords[i + 1 :]
            yield f"without {keyword.arg}=", _with(node, keywords=rest)
    if name in OTHER_NAMES:
        func = copy.copy(node.func)
        setattr(func, "attr" if isinstance(func, ast.Attribute) else "id", OTHER_NAMES[name])
        yield "function", _with(node, func=func)
    if name in LEFT_OUT and isinstance(node.func, ast.Attribute):
        yield (
            "call",
            node.args[0] if ast.unparse(node.func.value) in ("np", "math") else (node.func.value),
        )


def _with(node: ast.AST, **fields: object) -> ast.AST:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )
