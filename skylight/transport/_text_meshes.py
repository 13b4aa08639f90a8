"""Meshes in the dialects that programs write, put plainly for trimesh's readers.

What these would misread, or take for nothing, is mended or refused here.
"""

import re
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from skylight.errors import InputError

_CORNER_MARKS = (b"v", b"vt", b"vn")
_WORDS = (*_CORNER_MARKS, b"f", b"o", b"g", b"s", b"usemtl", b"mtllib")
# vertices count from 1, from -1 backwards; readers take 0 for the last
_NO_VERTEX = re.compile(rb"^f[^\n]* 0+(?:[/\s]|\Z)", re.M)
_BLANKS = bytes.maketrans(b"\t\f\v", b"   ")
_COMMENT = re.compile(rb"^( *(?:(?:v|vt|vn|f|fo) [^\n#]*)?)#[^\n]*", re.M)
_FREE_FORM = re.compile(rb"^(?:surf|curv2?|cstype) ", re.M)


def plain_obj(content: bytes) -> bytes:
    """Wavefront OBJ with single blanks, absolute indices and convex faces, without comments.

    ValueError for a face of vertex 0, or of vertices that are not there; InputError for free-form
    surfaces alone.
    """
    text = b"\n" + _unmarked(content).translate(_BLANKS)
    if b"\\" in text:  # a folder's name at the end of a comment continues nothing
        text = re.sub(rb"\\ *\n", b" ", _COMMENT.sub(rb"\1", text))
    if b"#" in text:
        text = _COMMENT.sub(rb"\1", text)
    while b"  " in text:
        text = text.replace(b"  ", b" ")
    text = text.replace(b"\n ", b"\n").replace(b" \n", b"\n").rstrip(b" ")
    text = text.replace(b"\nfo ", b"\nf ")  # older writers' faces
    faces = b"".join(re.findall(rb"\nf [^\n]*", text))[1:]
    if b" 0" in faces and _NO_VERTEX.search(faces):
        raise ValueError("a face names vertex 0, they count from 1")
    if not faces and _FREE_FORM.search(text):
        raise InputError("its surfaces are free-form (curv, surf): export it as triangles")
    # the reader tells kinds of corners by how many numbers a line has
    marks = faces.translate(None, b"0123456789+-")
    shapes = [line.split(b" ")[1:] for line in set(marks.split(b"\n"))]
    mixed = (
        len({corner for shape in shapes for corner in shape}) > 1
        or 0 < faces.count(b"//") < marks.count(b"//")
        or any(end in faces + b"\n" for end in (b"/ ", b"/\n"))
    )
    if not (mixed or b"-" in faces or any(len(shape) > 3 for shape in shapes)):
        return text
    lines = [line for line in text.split(b"\n") if line.partition(b" ")[0] in _WORDS]
    if b"-" in faces:
        lines = _absolute(lines)
    if mixed:
        lines = [_alike(line) if line.startswith(b"f ") else line for line in lines]
    return b"\n".join(_cut(lines, fans=mixed))


def _unmarked(content: bytes) -> bytes:
    """The text without a byte order mark, its lines ended by line feeds."""
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        content = content.decode("utf-16").encode()
    content = content.removeprefix(b"\xef\xbb\xbf")
    return content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def _absolute(lines: list[bytes]) -> list[bytes]:
    """Relative indices count from the lines before their own."""
    seen = [0, 0, 0]
    marks = {mark: kind for kind, mark in enumerate(_CORNER_MARKS)}
    out = []
    for line in lines:
        word, _, rest = line.partition(b" ")
        if word in marks:
            seen[marks[word]] += 1
        elif word == b"f" and b"-" in rest:
            corners = [
                b"/".join(
                    number if not number.startswith(b"-") else _from_end(number, count)
                    for number, count in zip(corner.split(b"/"), seen, strict=False)
                )
                for corner in rest.split()
            ]
            line = b"f " + b" ".join(corners)
        out.append(line)
    return out


def _from_end(number: bytes, count: int) -> bytes:
    place = count + 1 + int(number)
    if place < 1:
        raise ValueError(f"a face names vertex {int(number)}, where {count} stand before it")
    return b"%d" % place


def _alike(line: bytes) -> bytes:
    """A face with places in a texture at all its corners or at none, and without normals."""
    corners = [corner.split(b"/")[:2] for corner in line.split()[1:]]
    whole = all(len(corner) == 2 and corner[1] for corner in corners)
    return b"f " + b" ".join(b"/".join(corner if whole else corner[:1]) for corner in corners)


def _cut(lines: list[bytes], fans: bool) -> list[bytes]:
    """Polygons as triangles where they are no fan about their first corner; ``fans``: all."""
    rows = [line for line in lines if line.startswith(b"v ")]
    if any(line.count(b" ") < 3 for line in rows):
        raise ValueError("a vertex has fewer than three coordinates")
    kinds: dict[tuple[int, int], list[int]] = {}  # corners, what is told of them -> lines
    for number, line in enumerate(lines):
        if line.startswith(b"f ") and line.count(b" ") > 3:
            kinds.setdefault((line.count(b" "), line.count(b"/")), []).append(number)
    if not kinds:
        return lines
    places = np.loadtxt(rows, comments=None, usecols=(1, 2, 3), ndmin=2)
    out = list(lines)
    for (size, _), found in kinds.items():
        plain = b"\n".join(lines[k][2:] for k in found).replace(b"/", b" ").split(b"\n")
        numbers = np.loadtxt(plain, np.int64, comments=None, ndmin=2)
        index = numbers.reshape(len(found), size, -1)[..., 0] - 1
        for row, cut in _cut_polygons(places, index, fans).items():
            words = lines[found[row]].split()[1:]
            faces = (b"f " + b" ".join(words[k] for k in face) for face in cut.tolist())
            out[found[row]] = b"\n".join(faces)
    return out


def _cut_polygons(
    places: Float[np.ndarray, "n 3"], index: Int[np.ndarray, "m k"], fans: bool
) -> dict[int, Int[np.ndarray, "f 3"]]:
    """Of polygons of k corners, by row, the triangles of concave ones; ``fans``: of all."""
    if index.size and not 0 <= index.min() <= index.max() < len(places):
        raise ValueError(f"a face names vertex {index.max() + 1} of {len(places)}")
    fan = np.array([(0, k, k + 1) for k in range(1, index.shape[1] - 1)])
    cuts = {}
    for row in np.flatnonzero(_concave(places[index]) | fans).tolist():
        cut = triangulated(places[index[row]])
        if cut is not None or fans:
            cuts[row] = fan if cut is None else cut
    return cuts


def _concave(corners: Float[np.ndarray, "m n 3"]) -> Bool[np.ndarray, " m"]:
    """Which polygons turn back somewhere, seen along their mean normals."""
    after = np.roll(corners, -1, 1) - corners
    turns = np.cross(np.roll(after, 1, 1), after)
    normals = np.cross(corners - corners[:, :1], np.roll(corners, -1, 1) - corners[:, :1]).sum(1)
    return ((turns * normals[:, None]).sum(2) < 0).any(1)


def triangulated(corners: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, "f 3"] | None:
    """A polygon's triangles where it is concave, by clipping ears; None of a convex one.

    A hole may hang on its outline by two edges at one place. What crosses itself is None too.
    """
    flat = _flattened(corners)
    if flat is None:
        return None
    left, faces = list(range(len(flat))), []
    turns = _turns(flat, left)
    if (turns >= 0).all():
        return None
    while len(left) > 3:
        turns = _turns(flat, left)
        for k in np.argsort(turns <= 0, kind="stable").tolist():
            ear = [left[k - 1], left[k], left[(k + 1) % len(left)]]
            if turns[k] == 0:  # the end of a hole's bridge, or a corner that is none
                del left[k]
                break
            others = flat[left]
            others = others[(others[:, None] != flat[ear]).any(2).all(1)]
            if turns[k] > 0 and not _inside(flat[ear], others).any():
                faces.append(ear)
                del left[k]
                break
        else:
            return None
    return np.array([*faces, left]) if (_turns(flat, left) >= 0).all() else None


def _flattened(corners: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"] | None:
    """Seen along its normal, counter-clockwise; None without area."""
    normal = np.cross(corners, np.roll(corners, -1, 0)).sum(0)
    if not np.abs(normal).max() > 0:
        return None
    away = int(np.abs(normal).argmax())
    flat = corners[:, [(away + 1) % 3, (away + 2) % 3]]
    return flat if normal[away] > 0 else flat * [-1, 1]


def _turns(flat: Float[np.ndarray, "n 2"], left: list[int]) -> Float[np.ndarray, " k"]:
    """At each corner, above 0 where it is convex."""
    here = flat[left]
    before, after = here - np.roll(here, 1, 0), np.roll(here, -1, 0) - here
    return before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]


def _inside(ear: Float[np.ndarray, "3 2"], points: Float[np.ndarray, "k 2"]) -> Any:
    edges, to = np.roll(ear, -1, 0) - ear, points[:, None] - ear
    return np.all(edges[:, 0] * to[..., 1] - edges[:, 1] * to[..., 0] >= 0, axis=1)


_STL_HEAD, _STL_FACE = 84, 50
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.I)


def plain_stl(content: bytes) -> bytes:
    """STL of the length that its header tells, or in text with one corner a line.

    ValueError for a file that is cut short, and for facets that are no triangles.
    """
    told = struct.unpack("<I", content[80:84])[0] if len(content) >= _STL_HEAD else 0
    whole = _STL_HEAD + _STL_FACE * told
    text = _unmarked(content)
    is_text = text.lstrip()[:5].lower() == b"solid" and _VERTEX.search(text)
    if len(content) != whole and is_text:
        if not re.search(rb"\bendsolid\b", text, re.I):
            raise ValueError("cut short: it has no endsolid")
        body = re.sub(rb"^\s*(?:end)?solid\b[^\n]*?(?=\bfacet\b|$)", b"", text, flags=re.I | re.M)
        loops = re.split(rb"\bouter\s+loop\b", body, flags=re.I)[1:]
        corners = [_VERTEX.findall(loop) for loop in loops]
        if any(len(corner) != 3 for corner in corners):
            raise ValueError("cut short, or a facet that is no triangle")
        rows = (b"vertex " + b" ".join(place) for corner in corners for place in corner)
        return b"solid\n" + b"\n".join(rows) + b"\nendsolid\n"
    if (not is_text and len(content) < whole) or len(content) < _STL_HEAD:
        found = max(0, len(content) - _STL_HEAD) // _STL_FACE
        raise ValueError(f"cut short: {found} triangles of {told}")
    if told == 0 and len(content) > whole:
        raise ValueError("its header tells of no triangles")
    return content[:whole]  # some writers pad


_PLY_KINDS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip


def plain_ply(content: bytes) -> bytes:
    """PLY without what follows its last row; in text, where polygons are concave or of many sizes.

    ValueError for fewer rows than its header says; InputError for triangle strips.
    """
    head, end, body = content.partition(b"end_header")
    if not content.startswith(b"ply") or not end:
        raise ValueError("cut short, or it does not begin like one")
    elements: list[_Element] = []
    words = [row.split() for row in head.decode("latin-1").lower().splitlines()]
    for row in words:
        if row[:1] == ["element"]:
            elements.append((row[1], int(row[2]), []))
        elif row[:1] == ["property"]:
            elements[-1][2].append(row[1:])
    if any(name == "tristrips" for name, _, _ in elements):
        raise InputError("its triangles are strips, which are not read; export them one by one")
    if ["format", "ascii", "1.0"] in words:
        rows = [row for row in _unmarked(body).split(b"\n") if row.strip()]
        wanted = sum(count for _, count, _ in elements)
        if len(rows) < wanted:
            raise ValueError(f"cut short: {len(rows)} rows of {wanted}")
    else:
        order = ">" if ["format", "binary_big_endian", "1.0"] in words else "<"
        body = body.removeprefix(b"\r").removeprefix(b"\n")
        try:
            length, corners = _length(body, elements, order)
            if length is not None and corners <= 3:
                return content[: len(content) - len(body) + length]
            rows = list(_unpacked(body, elements, order))
        except struct.error as error:
            raise ValueError(f"cut short: {len(body)} bytes of rows") from error
    head = re.sub(rb"format\s+binary_\w+", b"format ascii", _unmarked(head))
    head, rows = _with_triangles(head, rows, elements)
    return head + b"end_header\n" + b"\n".join(rows) + b"\n"


def _with_triangles(
    head: bytes, rows: list[bytes], elements: list["_Element"]
) -> tuple[bytes, list[bytes]]:
    """Header and rows of a PLY in text, its polygons cut where trimesh would not read them so."""
    tables, start = {}, 0
    for name, count, told in elements:
        tables[name] = (start, count, told)
        start += count
    if not {"vertex", "face"} <= set(tables):
        return head, rows
    start, count, told = tables["face"]
    names = [words[-1] for words in told]
    lists = [words[0] == "list" for words in told]
    at = next((k for k, name in enumerate(names) if name.startswith("vertex_ind")), None)
    if at is None:
        return head, rows
    fields = [_fields(row.split(), lists) for row in rows[start : start + count]]
    sizes: dict[int, list[int]] = {}  # corners -> faces
    for number, row in enumerate(fields):
        sizes.setdefault(len(row[at]), []).append(number)
    if set(sizes) <= {3}:
        return head, rows
    first, vertices, columns = tables["vertex"]
    x = [[words[-1] for words in columns].index(axis) for axis in "xyz"]
    shape = [words[0] == "list" for words in columns]
    places = np.array(
        [
            [float(row[k][0]) for k in x]
            for row in (_fields(row.split(), shape) for row in rows[first : first + vertices])
        ]
    ).reshape(-1, 3)
    fans, out = len(sizes) > 1 and len(told) > 1, [[row] for row in rows[start : start + count]]
    for size, found in sizes.items():
        if size < 3:
            continue
        index = np.array([[int(word) for word in fields[number][at]] for number in found])
        for row, cut in _cut_polygons(places, index, fans).items():
            out[found[row]] = [
                _face_row(fields[found[row]], lists, face, size) for face in cut.tolist()
            ]
    made = [row for face in out for row in face]
    head = re.sub(rb"(element\s+face\s+)\d+", rb"\g<1>%d" % len(made), head)
    return head, [*rows[:start], *made, *rows[start + count :]]


def _fields(words: list[bytes], lists: list[bool]) -> list[list[bytes]]:
    """The values of each property in a row."""
    fields, at = [], 0
    for is_list in lists:
        length = int(words[at]) if is_list else 1
        at += is_list
        fields.append(words[at : at + length])
        at += length
    return fields


def _face_row(fields: list[list[bytes]], lists: list[bool], face: list[int], size: int) -> bytes:
    """One triangle of a polygon; lists of so many values a corner are cut with it."""
    words = []
    for values, is_list in zip(fields, lists, strict=True):
        each, rest = divmod(len(values), size)
        if is_list and each and not rest:
            values = [value for k in face for value in values[each * k : each * (k + 1)]]
        words += [b"%d" % len(values), *values] if is_list else values
    return b" ".join(words)


_Element = tuple[str, int, list[list[str]]]  # its name, how many, the words of each property


def _length(body: bytes, elements: list[_Element], order: str) -> tuple[int | None, int]:
    """The bytes of all rows, and the most corners of a face; None where rows differ in length."""
    at = most = 0
    for name, count, properties in elements:
        if not count:
            continue
        fields, end = [], at
        for number, (first, *more) in enumerate(properties):
            kind = np.dtype(order + _PLY_KINDS[more[0] if first == "list" else first])
            fields.append((f"n{number}", kind))
            length = 1
            if first == "list":
                (length,) = struct.unpack_from(order + kind.char, body, end)
                end += kind.itemsize
                kind = np.dtype(order + _PLY_KINDS[more[1]])
                fields.append((f"v{number}", kind, (length,)))
                if name == "face" and more[2].startswith("vertex_ind"):
                    most = length
            end += kind.itemsize * length
        row = np.dtype(fields)
        if at + count * row.itemsize > len(body):
            if all(first != "list" for first, *_ in properties):
                raise ValueError(f"cut short: {len(body)} bytes of rows")
            return None, most
        rows = np.frombuffer(body, row, count, at)
        for number, (first, *_) in enumerate(properties):
            if first == "list" and (rows[f"n{number}"] != rows[f"n{number}"][0]).any():
                return None, most
        at += count * row.itemsize
    return at, most


def _unpacked(body: bytes, elements: list[_Element], order: str) -> Iterator[bytes]:
    at = 0

    def taken(kind: str, count: int = 1) -> tuple:
        nonlocal at
        form = f"{order}{count}{np.dtype(_PLY_KINDS[kind]).char}"
        values = struct.unpack_from(form, body, at)
        at += struct.calcsize(form)
        return values

    for _, count, properties in elements:
        for _ in range(count):
            row: list[float] = []
            for first, *more in properties:
                if first == "list":
                    (length,) = taken(more[0])
                    row += [length, *taken(more[1], length)]
                else:
                    row += taken(first)
            yield " ".join(map(repr, row)).encode()


def plain_off(content: bytes) -> bytes:
    """OFF without comments, of which the reader loses the rows behind them.

    ValueError for a text of fewer rows than it says; InputError for a binary file. A row that is
    cut within its last number cannot be told.
    """
    if b"BINARY" in content[:20]:
        raise InputError("it is binary, which is not read; export it as text")
    text = re.sub(rb"#[^\n]*", b"", _unmarked(content)).lstrip()
    rows = [row for row in text.split(b"\n") if row.strip()]
    name, *counts = rows.pop(0).split() if rows else [b""]
    if not name.endswith(b"OFF"):
        raise ValueError("it does not begin with OFF")
    counts = counts or (rows.pop(0).split() if rows else [])  # they may stand beside the name
    if len(counts) < 2:
        raise ValueError("it does not tell how many vertices and faces it has")
    vertices, faces = (int(word) for word in counts[:2])
    if len(rows) < vertices + faces:
        raise ValueError(f"cut short: {len(rows)} rows of {vertices + faces}")
    places = np.array([[float(word) for word in row.split()[:3]] for row in rows[:vertices]])
    made = []
    for row in rows[vertices : vertices + faces]:
        size, *words = row.split()
        size = int(size)
        index = np.array([[int(word) for word in words[:size]]])
        cuts = _cut_polygons(places, index, fans=False) if size > 3 else {}
        made += (
            [
                b" ".join([b"3", *(words[k] for k in face), *words[size:]])
                for face in cuts[0].tolist()
            ]
            if cuts
            else [row]
        )
    head = [name, b"%d %d 0" % (vertices, len(made))]
    return b"\n".join([*head, *rows[:vertices], *made]) + b"\n"
