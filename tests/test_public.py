"""What packages make public: each name is there, and says what it is."""

import importlib
import inspect
import pkgutil

import pytest

import skylight

PACKAGES = [
    "skylight",
    *(each.name for each in pkgutil.walk_packages(skylight.__path__, "skylight.") if each.ispkg),
]


@pytest.mark.parametrize("package", PACKAGES)
def test_what_a_package_lists_is_there_and_documented(package: str) -> None:
    module = importlib.import_module(package)
    assert module.__doc__
    names = [name for name in getattr(module, "__all__", []) if not name.startswith("__")]
    assert names == sorted(set(names))
    for name in names:
        value = getattr(module, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            assert inspect.getdoc(value), f"{package}.{name} has no docstring"
