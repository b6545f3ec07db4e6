"""Test settings: double precision, strict dtypes, and every annotation of the package checked at run time."""

import pathlib

import jax
import pytest
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
install_import_hook("jaxscp", "beartype.beartype")

MOST_MAPPINGS = 20_000
"""Of a process. Compiled programs hold thousands each, and where Linux allows no more (65 530 as a rule) the compiler
dies."""


from jaxscp.backends import libraries  # noqa: E402, with its annotations checked


@pytest.fixture(params=libraries.LEVELS)
def at_level(request, monkeypatch):
    """One after another of what is compiled: has a module call its library of that level.

    Takes the module, whose LIBRARY it is, and the names of its targets there.
    """

    def use(module, *names):
        library = libraries.library(module.LIBRARY.stem, request.param)
        if library is None:
            pytest.skip(
                f"{request.param} is not built for this kind of machine, or it lacks the instructions"
            )
        for name in names:
            handler = getattr(module, name)
            assert libraries.register(library, handler, target=f"{handler}_{request.param}")
            monkeypatch.setattr(module, name, f"{handler}_{request.param}")
        monkeypatch.setattr(libraries.Library, "available", lambda _: True)

    return use


def pytest_runtest_teardown(item, nextitem):
    """Drop compiled programs before there are too many, between modules and after slow tests."""
    mappings = pathlib.Path("/proc/self/maps")
    over = nextitem is None or nextitem.path != item.path or item.get_closest_marker("slow")
    if over and mappings.exists() and mappings.read_bytes().count(b"\n") > MOST_MAPPINGS:
        jax.clear_caches()
