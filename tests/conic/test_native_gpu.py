"""The GPU's kernel without a GPU: emulated on a CPU by threads that take turns, and compiled by NVIDIA's compiler.

Its steps are compared with the loop for CPUs, which ``test_native`` compares with JAX.
"""

import ctypes
import shutil
import subprocess
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.backends import libraries
from jaxscp.conic import native
from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.native import gpu
from jaxscp.conic.program import ConicMultipliers, WarmStart
from jaxscp.conic.random_programs import random_program

COMPILER = shutil.which("g++")
needs_compiler = pytest.mark.skipif(
    COMPILER is None or not native.LIBRARY.available(), reason="no g++ to compile the kernel for this machine"
)
ROUNDING = 1e-9  # relative, as for the loop for CPUs
STEPS = 4
THREADS = 64  # of the emulated block: two warps with barriers between them

SHAPES = {
    "norm cost": {"nodes": 5, "variables": 6, "rows": 3, "cones": 2},
    "quadratic cost, no cones": {"nodes": 4, "cones": 0, "norm": False},
    "more rows than lanes": {"nodes": 2, "variables": 20, "rows": 2},
    "one lane per row, and an odd column left": {"nodes": 3, "variables": 17, "rows": 2},
    "a chain too long for shared memory": {"nodes": 190, "variables": 8, "rows": 2, "cones": 0},
    # nearly diagonal Hessians, by the number of coupled variables
    "three coupled": {"nodes": 5, "variables": 10, "rows": 4, "cones": 1, "coupled": 3},
    "none coupled": {"nodes": 3, "variables": 6, "rows": 3, "cones": 0, "coupled": 1},
    "two coupled, no norm": {"nodes": 3, "variables": 6, "rows": 3, "cones": 1, "coupled": 2, "norm": False},
    "variables outnumber entries": {"nodes": 3, "variables": 18, "rows": 2, "coupled": 2, "norm": False},
    "too many coupled": {"nodes": 3, "variables": 6, "rows": 3, "cones": 1, "coupled": 4},
}
SMALL_MEMORY = 16 * 1024  # bytes of a multiprocessor, too few for these shapes' vectors and indices
WITH_SMALL_MEMORY = "a chain too long for shared memory", "more rows than lanes"
BY_NIGHT = (
    "a chain too long for shared memory",
    "one lane per row, and an odd column left",
    "none coupled",
    "variables outnumber entries",
    "too many coupled",
)
TIERS = {"norm cost": [], **{name: [pytest.mark.nightly] for name in BY_NIGHT}}  # the others are slow


def emulated(program, folder: Path, *macros: str) -> ctypes.CDLL:
    """Library of the emulated kernel for a program's sizes, with a handler for CPUs."""
    library = folder / "kernel.so"
    source = Path(__file__).parents[1] / "support/gpu_on_a_cpu.cc"
    flags = ["-std=c++20", "-O1", "-fno-math-errno", "-fPIC", "-w", "-shared"]
    # Otherwise kernels of all sizes would share one block's static variables in the process.
    flags += ["-fno-gnu-unique"]
    defined = [f"-DJAXSCP_SIZES={gpu.sizes_of(program)}", f"-DJAXSCP_THREADS={THREADS}", *macros]
    folders = Path(native.__file__).parent, libraries.HEADERS, source.parent
    found = [f"-I{folder}" for folder in folders]
    subprocess.run([COMPILER, *flags, *defined, *found, str(source), "-o", str(library)], check=True)
    return ctypes.CDLL(str(library))


@pytest.fixture(
    scope="module",
    params=[
        pytest.param((name, sizes), id=name, marks=TIERS.get(name, [pytest.mark.slow]))
        for name, sizes in SHAPES.items()
    ],
)
def kernel(request, tmp_path_factory):
    """Programs of one shape, and the name of their kernel."""
    shape, sizes = request.param
    programs = [program_of(seed, **sizes) for seed in range(3)]
    macros = [f"-DJAXSCP_SHARED={SMALL_MEMORY}"] if shape in WITH_SMALL_MEMORY else []
    name = f"jaxscp_test_kernel_{request.param_index}"
    library = emulated(programs[0], tmp_path_factory.mktemp("kernel"), *macros)
    assert libraries.register(library, native.TARGET, target=name)
    return programs, name


def program_of(seed, coupled=None, **sizes):
    """Random program; with ``coupled``, only the first variables of a node are coupled by half-spaces and cones."""
    program = random_program(seed, **sizes)
    if coupled is None:
        return program
    rows, n = program.rows.matrix.shape[1:]
    few = (np.arange(n) < coupled).astype(float)
    single = np.arange(rows)[:, None] % n == np.arange(n)
    of_rows = np.where(
        np.arange(rows)[:, None] == 0, few, single
    )  # all rows but the first bound one variable each
    hessian = program.hessian * np.maximum(np.outer(few, few), np.eye(n))
    return eqx.tree_at(
        lambda p: (p.hessian, p.rows.matrix, p.cones),
        program,
        (
            hessian,
            program.rows.matrix * of_rows,
            tuple(eqx.tree_at(lambda c: c.matrix, cone, cone.matrix * few) for cone in program.cones),
        ),
    )


def sparser(program):
    """Program with fewer entries: links use every other variable, the first half-space uses one variable."""
    links, rows = program.links, program.rows.matrix
    m, n = links.after.shape[1:]
    alternate = (np.add.outer(np.arange(m), np.arange(n)) % 2 == 0).astype(float)
    single = np.where(np.arange(rows.shape[1])[:, None] == 0, np.arange(n) == 0, 1.0)
    return eqx.tree_at(
        lambda p: (p.links.before, p.links.after, p.rows.matrix),
        program,
        (links.before * alternate, links.after * alternate, rows * single),
    )


def iterate(solver, programs, warm_start=None):
    return eqx.filter_jit(jax.vmap(lambda p, w: solver.iterate(p, None, w)))(programs, warm_start)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(
    "warm", [False, pytest.param(True, marks=pytest.mark.nightly)], ids=["cold start", "warm start"]
)
def test_steps_are_the_same_and_batch_elements_independent(kernel, monkeypatch, warm):
    programs, name = kernel
    poisoned = eqx.tree_at(lambda p: p.gradient, programs[1], programs[1].gradient * jnp.nan)
    # The sparsity is analysed again only if it differs from the last program's.
    programs = [sparser(programs[0]), poisoned, programs[2], sparser(programs[0])]
    batch = jax.tree.map(lambda *v: jnp.stack(v), *programs)
    warm_start = None
    if warm:
        tenth = lambda v: jnp.full(v.shape, 0.1)  # noqa: E731
        estimates = [
            WarmStart(tenth(p.gradient), jax.tree.map(tenth, ConicMultipliers.zeros(p))) for p in programs
        ]
        warm_start = jax.tree.map(lambda *v: jnp.stack(v), *estimates)
    expected = iterate(InteriorPoint(max_iterations=STEPS), batch, warm_start)
    monkeypatch.setattr(native, "TARGET", name)
    monkeypatch.setattr(libraries.Library, "available", lambda _: True)
    found = iterate(InteriorPoint(max_iterations=STEPS), batch, warm_start)
    assert found.broken.tolist() == [False, True, False, False]
    np.testing.assert_array_equal(found.iterations, expected.iterations)
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        for element in (0, 2, 3):
            size = max(1.0, float(jnp.max(jnp.abs(theirs[element]), initial=0.0)))
            np.testing.assert_allclose(ours[element], theirs[element], rtol=0, atol=ROUNDING * size)


@pytest.mark.nightly
@pytest.mark.skipif(gpu.compiler() is None, reason="needs NVIDIA's run-time compiler (extra cuda)")
@pytest.mark.parametrize("capability", ["80", "90"])
def test_kernel_compiles(capability):
    cubin = gpu.kernel(gpu.sizes_of(random_program(0)), capability)
    assert cubin is not None
    assert cubin.startswith(b"\x7fELF")


@pytest.mark.skipif(gpu.compiler() is None, reason="needs NVIDIA's run-time compiler (extra cuda)")
def test_an_unknown_gpu_runs_jax():
    with pytest.warns(UserWarning, match="runs as JAX"):
        assert gpu.kernel(gpu.sizes_of(random_program(0)), "999") is None


def test_sizes_too_large_for_a_warp_run_jax():
    assert gpu.sizes_of(random_program(0, variables=20)).fit
    assert not gpu.sizes_of(random_program(0, variables=34)).fit
    assert not native.supports_on_gpu(random_program(0))  # JAX runs on a CPU here
