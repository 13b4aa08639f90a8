"""Which Host headers name a server of this machine."""

import pytest

from skylight.work._own_host import is_own


@pytest.mark.parametrize(
    ("host", "bound", "own"),
    [
        ("127.0.0.1:8600", "127.0.0.1", True),
        ("LOCALHOST", "127.0.0.1", True),
        ("[::1]:8600", "127.0.0.1", True),
        ("192.168.0.7:8600", "127.0.0.1", False),
        ("192.168.0.7:8600", "192.168.0.7", True),
        ("192.168.0.7:8600", "0.0.0.0", True),
        ("studio.lan:80", "Studio.lan", True),
        ("studio.lan:80", "0.0.0.0", False),
        ("127.0.0.1@evil.example", "127.0.0.1", False),
    ],
)
def test_own_names(host: str, bound: str, own: bool) -> None:
    assert is_own(host, bound) is own
