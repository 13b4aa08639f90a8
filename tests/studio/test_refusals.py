"""What the server refuses: each in one line of JSON, as careful as any other answer."""

from collections.abc import Iterator
from itertools import product
from typing import Any
from urllib.parse import quote

import httpx
import pytest

from skylight.studio._state import PREFIX

Refusal = tuple[str, str, dict[str, Any], int, str]  # method, path, options, status, words


def pages() -> Iterator[Refusal]:
    for path in (
        "/nothing.js", "/../application.py", "/%2e%2e/application.py", "/..%2fapplication.py",
        "/assets/../../server.py", "//etc/passwd", "/api/nothing", "/assets",
    ):  # fmt: skip
        yield "GET", path, {}, 404, "there is no such page"
    for name in ("nobody", "Astronaut", "astronaut.png", "..", "%0a"):
        line = "there is no such example; choose one of astronaut, cameraman"
        yield "GET", f"/api/examples/{name}.png", {}, 404, line
    for method in ("POST", "PUT", "DELETE"):
        yield method, "/api/examples/astronaut.png", {}, 405, "Method Not Allowed"


def foreign() -> Iterator[Refusal]:
    """Hosts and pages."""
    for host in ("evil.example", "127.0.0.1.evil.example:8600", "", "[::1"):
        headers = {"Host": host}
        yield "GET", "/api/about", {"headers": headers}, 403, "not this server's name"
    asked = [("POST", "/api/photos"), ("POST", "/api/jobs"), ("DELETE", "/api/jobs/x")]
    told = [
        ("Origin", "http://evil.example"),
        ("Origin", "null"),
        ("Origin", "http://127.0.0.1:1"),
        ("Origin", "http://[::1"),
        ("Sec-Fetch-Site", "cross-site"),
        ("Sec-Fetch-Site", "same-site"),
    ]
    for (method, path), header in product(asked, told):
        yield method, path, {"headers": dict([header]), "content": b"{}"}, 403, "may not drive"


def unknown() -> Iterator[Refusal]:
    gone = "(any more); begin again"
    for path in ("jobs/x", "jobs/x/events", "jobs/x/files/a", "jobs/x/files.zip"):
        yield "GET", f"/api/{path}", {}, 404, gone
    yield "GET", "/api/photos/x/preview.jpg", {}, 404, gone
    for kind, of in (("estimate", "photo"), ("code", "map"), ("voxel", "job"), ("portrait", "job")):
        yield "POST", "/api/jobs", {"json": {"kind": kind, of: "x"}}, 404, gone


def unusable() -> Iterator[Refusal]:
    yield "POST", "/api/maps?name=me.jpg", {"content": b"x"}, 415, ".exr or .hdr files"
    for wanted, words in (
        ({"kind": "paint"}, "paint"),
        ({}, "kind"),
        ([], "valid dictionary"),
        ({"kind": "estimate"}, "photo: Field required"),
        ({"kind": "estimate", "photo": 7}, "photo: Input should be a valid string"),
        ({"kind": "estimate", "photo": "x", "face": "1"}, "face"),
        ({"kind": "estimate", "photo": "x", "face": 0}, "face"),
        ({"kind": "estimate", "photo": "x", "light": "candle"}, "light"),
        ({"kind": "estimate", "photo": "x", "path": "/etc"}, "path: Extra inputs"),
        ({"kind": "code", "activations": 257}, "activations"),
        ({"kind": "code", "activations": True}, "activations"),
        ({"kind": "code"}, "name a map"),
        ({"kind": "code", "map": "x", "job": "y"}, "not both"),
        ({"kind": "voxel", "probe": 2.5}, "probe"),
        ({"kind": "voxel", "probe": 4}, "probe"),
        ({"kind": "partitions", "design": ["14d"]}, "design"),
        ({"kind": "portrait"}, "job: Field required"),
        ({"kind": "portrait", "job": "it", "face": 2}, "face: Extra inputs"),
    ):
        yield "POST", "/api/jobs", {"json": wanted}, 422, words
    plain = {"content": b"{}", "headers": {"Content-Type": "text/plain"}}
    yield "POST", "/api/jobs", plain, 415, "Content-Type: application/json"
    yield "POST", "/api/jobs", {"json": {"kind": "x" * 70_000}}, 413, "in one request"


def uploads() -> Iterator[Refusal]:
    for name, content, status, words in (
        ("a.jpg", b"", 400, "nothing came in"),
        ("a.jpg", b"no picture", 422, "a.jpg: no picture known here"),
        ("a.png", b"\x89PNG\r\n\x1a\nno", 422, "a.png: "),
        (
            "a.exr",
            b"\x76\x2f\x31\x01" + b"x" * 50,
            422,
            "a.exr: cannot be read: its header is damaged",
        ),
        ("..\\..\\x\n.hdr", b"#?RADIANCE\n", 422, "x.hdr: cannot be read: damaged"),
    ):
        yield "POST", f"/api/photos?name={quote(name)}", {"content": content}, status, words


def refused(
    client: httpx.Client, method: str, path: str, options: dict[str, Any], status: int
) -> str:
    """The line that is answered."""
    url = httpx.URL(client.base_url, raw_path=path.encode())
    answer = client.request(method, url, **options)
    assert answer.status_code == status
    assert list(answer.json()) == ["error"]
    error = answer.json()["error"]
    assert "\n" not in error
    assert PREFIX not in error  # the folder where files are put
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    return error


@pytest.mark.parametrize(("method", "path", "options", "status", "line"), [*pages()])
def test_what_is_no_page_is_refused_by_this_line(
    client: httpx.Client, method: str, path: str, options: dict[str, Any], status: int, line: str
) -> None:
    assert refused(client, method, path, options, status) == line


@pytest.mark.parametrize(("method", "path", "options", "status", "words"), [*uploads()])
def test_files_that_are_refused_are_named_first(
    client: httpx.Client, method: str, path: str, options: dict[str, Any], status: int, words: str
) -> None:
    assert refused(client, method, path, options, status).startswith(words)


@pytest.mark.parametrize(
    ("method", "path", "options", "status", "words"), [*foreign(), *unknown(), *unusable()]
)
def test_what_is_refused_is_one_line(
    client: httpx.Client, method: str, path: str, options: dict[str, Any], status: int, words: str
) -> None:
    assert words in refused(client, method, path, options, status)
