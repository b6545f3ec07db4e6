"""Test settings: double precision, strict dtypes, and annotations of the package checked at run time."""

import atexit
import os
import shutil
import tempfile

# All processes of a test run compile each program once. JAX reads these variables when it is imported.
PROGRAMS = "JAX_COMPILATION_CACHE_DIR"
if PROGRAMS not in os.environ:
    os.environ[PROGRAMS] = tempfile.mkdtemp(prefix="jaxscp-programs-")
    atexit.register(shutil.rmtree, os.environ[PROGRAMS], ignore_errors=True)
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")

import jax  # noqa: E402
import jaxtyping  # noqa: E402
import pytest  # noqa: E402

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")

# Imported before the hook: to check its million scalar operations would double the time of a trace.
import jaxscp.backends.codegen.graph  # noqa: E402, F401

jaxtyping.install_import_hook("jaxscp", "beartype.beartype")

MOST_MAPPINGS = 20_000
"""Largest number of memory mappings of a process. Each compiled program holds thousands. Beyond Linux's limit (usually
65 530) the compiler ends the process."""


from jaxscp.aot import mappings  # noqa: E402, after the import hook
from jaxscp.backends import libraries, xla  # noqa: E402

if jax.__version_info__ < (0, 12):  # later versions lack a flag, and XLA ends a process with an unknown flag
    # the tests' own ``jit``, and their subprocesses, compile with the options of the package's programs
    flags = (f"--{name}={str(value).lower()}" for name, value in xla.CPU_OPTIONS.items())
    os.environ.setdefault("XLA_FLAGS", " ".join(flags))


@pytest.fixture
def no_type_checks():
    """Wrong types meet the library's own checks, as a user's do, not those that the tests add."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(params=libraries.LEVELS)
def at_level(request, monkeypatch):
    """A function that makes a module call its library of one instruction level; one test for each level.

    Arguments of the function: a module with an attribute LIBRARY, and the names of its targets.
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
    """Drop compiled programs before a process has too many, between modules and after slow tests."""
    over = nextitem is None or nextitem.path != item.path or item.get_closest_marker("slow")
    if over and mappings.count() > MOST_MAPPINGS:
        jax.clear_caches()
