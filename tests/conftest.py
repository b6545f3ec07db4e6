"""Test settings: double precision, strict dtypes, and every annotation of the package checked at run time."""

import pathlib

import jax
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
install_import_hook("jaxscp", "beartype.beartype")

MOST_MAPPINGS = 20_000
"""Of a process. Compiled programs hold thousands each, and where Linux allows no more (65 530 as a rule) the compiler
dies."""


def pytest_runtest_teardown(item, nextitem):
    """Drop compiled programs before there are too many, between modules and after slow tests."""
    mappings = pathlib.Path("/proc/self/maps")
    over = nextitem is None or nextitem.path != item.path or item.get_closest_marker("slow")
    if over and mappings.exists() and mappings.read_bytes().count(b"\n") > MOST_MAPPINGS:
        jax.clear_caches()
