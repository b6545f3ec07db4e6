"""Planners compiled ahead of time, stored, and loaded by another process."""

import dataclasses
import json
import os
import subprocess
import sys
import zipfile

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp import scenarios
from jaxscp.aot import cache_folder
from jaxscp.aot.planner_cache import cached
from jaxscp.aot.pytree_spec import difference, spec_of, zeros_of
from jaxscp.backends import libraries
from jaxscp.conic import OSQP
from jaxscp.conic.interior_point import InteriorPoint

# The paper's mode on few nodes: the shortest compilation.
PLANNER = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=6), samples=20)

FRESH = """
import sys
import jax
import numpy as np
jax.config.update("jax_enable_x64", True)
import jaxscp

solution = jaxscp.load(sys.argv[1], compile=False)(jaxscp.scenarios.ascent_to_platform())
modules = {"jaxscp.solver.planner", "jaxscp.solver.pipeline", "jaxscp.solver.solver"}
needless = {*modules, "diffrax", "jaxopt", "osqp", "matplotlib", *sys.argv[3:]} & set(sys.modules)
assert not needless, needless
np.savez(sys.argv[2], *jax.tree.leaves(solution))
"""


@pytest.fixture(scope="module")
def scenario():
    return scenarios.ascent_to_platform()


@pytest.fixture(scope="module")
def expected(scenario):
    return PLANNER(scenario)


@pytest.fixture(scope="module")
def answer(from_file, scenario):
    """Plan of the loaded planner. Compilation of the planner itself would take as long as all other tests here."""
    return from_file(scenario)


@pytest.fixture(scope="module")
def file(scenario, tmp_path_factory):
    file = tmp_path_factory.mktemp("export") / "planner.jaxscp"
    PLANNER.export(file, scenario)
    return file


@pytest.fixture(scope="module")
def from_file(file):
    return jaxscp.load(file)


def assert_same(found, expected):
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_a_loaded_planner_gives_the_same_bits(from_file, scenario, expected):
    assert_same(from_file(scenario), expected)


def planned_afresh(file, tmp_path, *needless):
    """Leaves of the plan by another process, which imports none of these modules."""
    found = tmp_path / "answer.npz"
    subprocess.run(
        [sys.executable, "-c", FRESH, file, found, *needless],
        check=True,
        env={**os.environ, "JAX_PLATFORMS": "cpu"},
    )
    with np.load(found) as leaves:
        return list(leaves.values())


def test_a_fresh_process_loads_and_plans_without_tracing(file, answer, tmp_path):
    compiled = all(library.available() for library in libraries.EVERY)
    needless = ["scipy.linalg"] if compiled else []  # JAX imports this module for LAPACK
    for one, other in zip(planned_afresh(file, tmp_path, *needless), jax.tree.leaves(answer), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.nightly
def test_a_fresh_process_finds_the_lapack_that_a_planner_calls(scenario, tmp_path):
    in_jax = dataclasses.replace(
        PLANNER, method=jaxscp.PTR(max_iterations=2, conic=InteriorPoint(compiled=False))
    )
    in_jax.export(tmp_path / "planner.jaxscp", scenario)
    found = planned_afresh(tmp_path / "planner.jaxscp", tmp_path)
    for one, other in zip(found, jax.tree.leaves(in_jax(scenario)), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_loaded_planner_refuses_what_the_planner_refuses(from_file, scenario):
    heavy = eqx.tree_at(lambda s: s.airframe.body.mass, scenario, jnp.array(40.0))
    with pytest.raises(jaxscp.InvalidScenario, match="airframe"):
        from_file(heavy)


def test_another_shape_is_named(from_file, scenario):
    with pytest.raises(
        TypeError, match=r"corridor\.normals: float64 of shape \(3, .*\) expected, got .* \(5, "
    ):
        from_file(scenarios.platform_to_platform())
    with pytest.raises(TypeError, match=r"limits\.speed: None expected, got float64 of shape \(\)"):
        from_file(dataclasses.replace(scenario, limits=jaxscp.flight_limits(speed=3.0)))


def test_obstacles_are_no_part_of_the_shape(from_file, scenario, answer):
    assert_same(from_file(dataclasses.replace(scenario, obstacles=scenario.obstacles[:5])), answer)


def test_inside_vmap_it_says_what_to_call(from_file, scenario):
    with pytest.raises(TypeError, match="call the Planner itself"):
        jax.vmap(lambda mass: from_file(eqx.tree_at(lambda s: s.airframe.body.mass, scenario, mass)))(
            jnp.ones(2)
        )


def test_a_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        jaxscp.load(tmp_path / "nowhere")


def test_another_kind_of_file(tmp_path, answer):
    text, archived = tmp_path / "text", tmp_path / "plan.npz"
    text.write_text("no archive")
    answer.trajectory.save(archived)
    for other in (text, archived):
        with pytest.raises(jaxscp.InvalidExport, match="not a planner that"):
            jaxscp.load(other)


def test_a_damaged_file(file, tmp_path):
    damaged = tmp_path / "damaged"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    damaged.write_bytes(content)
    with pytest.raises(jaxscp.InvalidExport, match="CRC"):
        jaxscp.load(damaged)


def with_header(file, target, **changes):
    """The export with another header."""
    with zipfile.ZipFile(file) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "header.json":
                content = json.dumps({**json.loads(content), **changes})
            new.writestr(name, content)
    return target


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": 9}, "its format is 9, .* export the planner again"),
        ({"platform": "abacus"}, "exported for abacus"),
        ({"solution": {"class": "os.system", "fields": {}}}, "another version of jaxscp"),
        ({"machine": {"jax": "0"}}, "another machine, which differs in jax, "),
    ],
)
def test_a_file_from_elsewhere(file, tmp_path, changes, message):
    with pytest.raises(jaxscp.InvalidExport, match=message):
        jaxscp.load(with_header(file, tmp_path / "other", **changes), compile=False)


def test_single_precision_is_refused(file, from_file, scenario):
    with jax.enable_x64(False):
        with pytest.raises(jaxscp.InvalidExport, match="jax_enable_x64"):
            jaxscp.load(file)
        with pytest.raises(jaxscp.InvalidScenario, match="jax_enable_x64"):
            from_file(scenario)


def test_a_folder_that_is_not_there_is_no_place_for_a_file(scenario, tmp_path):
    with pytest.raises(FileNotFoundError):
        PLANNER.export(tmp_path / "missing" / "planner.jaxscp", scenario)


def test_what_is_described_can_be_built_again(answer):
    description = json.loads(json.dumps(spec_of(answer.trajectory)))
    again = zeros_of(description, [jaxscp.Trajectory, jaxscp.RigidBody])
    assert difference(description, spec_of(again)) is None
    with pytest.raises(KeyError):
        zeros_of(description, [])


@pytest.mark.slow
def test_compiled_without_a_file_it_gives_the_same_bits(scenario, expected):
    shapes = jax.tree.map(lambda v: jax.ShapeDtypeStruct(v.shape, v.dtype), scenario)
    assert_same(PLANNER.compile(shapes)(scenario), expected)


@pytest.mark.slow
def test_the_portable_form_gives_the_same_bits_here(file, tmp_path, scenario, expected):
    elsewhere = with_header(file, tmp_path / "other", machine={})
    assert_same(jaxscp.load(elsewhere)(scenario), expected)


@pytest.mark.nightly
def test_a_batch_is_that_of_vmap(scenario):
    batch = jax.tree.map(lambda v: jnp.stack([v] * 3), scenario)
    masses = batch.airframe.body.mass * jnp.array([1.0, 1.1, jnp.nan])
    batch = eqx.tree_at(lambda s: s.airframe.body.mass, batch, masses)
    compiled = PLANNER.compile(scenario, batch_size=3)
    found = compiled(batch)
    assert_same(found, jax.vmap(PLANNER)(batch))
    assert jaxscp.status_names(found.status)[2] == "invalid_input"
    with pytest.raises(TypeError, match=r"body\.mass: a leading axis of 3 elements expected, got shape \(\)"):
        compiled(scenario)


@pytest.mark.nightly
def test_the_default_mode_comes_back_the_same(scenario, tmp_path):
    planner = jaxscp.Planner(nodes=10)
    planner.export(tmp_path / "planner.jaxscp", scenario)
    assert_same(jaxscp.load(tmp_path / "planner.jaxscp")(scenario), planner(scenario))


CACHED = """
import sys, jax
jax.config.update("jax_enable_x64", True)
import jaxscp
jaxscp.use_cache(sys.argv[1])
scenario = jaxscp.scenarios.ascent_to_platform()
planner = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=4), samples=20)
solution = planner(scenario)
jaxscp.use_cache(None)
expected = planner(scenario)
assert all((a == b).all() for a, b in zip(jax.tree.leaves(solution), jax.tree.leaves(expected), strict=True))
"""
NOTHING_TRACED = """
def traced(*arguments):
    raise AssertionError("a cached planner was traced")

from jaxscp.solver.pipeline import Pipeline

Pipeline.setup = Pipeline.trace = traced
"""


def cached_planners(folder):
    return sorted(file.name for file in folder.glob("planner-*"))


@pytest.mark.slow
def test_a_cached_planner_is_found_by_the_next_process(tmp_path):
    """The next process traces nothing, gets the same bits, and replaces a damaged file."""
    run = lambda code: subprocess.run(  # noqa: E731
        [sys.executable, "-c", code, tmp_path], check=True, capture_output=True, text=True
    )
    run(CACHED)
    (name,) = cached_planners(tmp_path)
    head, tail = CACHED.split("solution = ")
    plan_only = f"{head}{NOTHING_TRACED}solution = planner(scenario)\nassert float(solution.cost) > 0.0\n"
    run(plan_only)
    (tmp_path / name).write_bytes(b"damaged")
    assert "made again" in run(f"{head}solution = {tail}").stderr
    run(plan_only)
    assert cached_planners(tmp_path) == [name]


def test_a_folder_that_cannot_be_made_is_not_in_use(scenario, tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(FileExistsError):
        jaxscp.use_cache(tmp_path / "taken")
    assert cache_folder.folder() is None


def test_calls_that_are_not_for_the_default_device_compile_as_jax_does(scenario):
    with jax.default_device(jax.devices()[0]):  # code inside may use another default device
        assert cached(PLANNER.pipeline._maker(), scenario) is None
    with jax.disable_jit():
        assert cached(PLANNER.pipeline._maker(), scenario) is None


@pytest.mark.slow
def test_replans_share_what_plans_have_compiled(scenario, monkeypatch):
    planned = PLANNER(scenario)
    again = PLANNER.replan(planned, scenario)
    for name in ("_solve", "_conclude"):
        monkeypatch.setattr(f"jaxscp.solver.pipeline.{name}", None)
    assert_same(PLANNER.replan(planned, scenario), again)
    assert_same(PLANNER(scenario), planned)


@pytest.mark.slow
def test_code_of_other_packages_is_not_cached(scenario, tmp_path):
    class Mine(jaxscp.PTR):
        """A method defined by the user; another process may have another version of the class."""

    method, inputs = Mine(max_iterations=1), scenario.solver_inputs()
    jaxscp.use_cache(tmp_path)
    try:
        assert cached(jaxscp.Planner(nodes=10, method=method).pipeline._maker(), inputs) is not None
        own_solver = jaxscp.PTR(max_iterations=1, conic=lambda p, a, n: InteriorPoint()(p, a, n))
        assert cached(jaxscp.Planner(nodes=10, method=own_solver).pipeline._maker(), inputs) is not None
        jax.jit(lambda: cached(PLANNER.pipeline._maker(), inputs) is None or 1 / 0)()
    finally:
        jaxscp.use_cache(None)
    assert not cached_planners(tmp_path)


@pytest.mark.nightly
def test_a_solver_on_the_host_plans_though_it_cannot_be_cached(scenario, tmp_path):
    planner = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=1, conic=OSQP()), samples=20)
    expected = planner(scenario)
    jaxscp.use_cache(tmp_path)
    try:
        with pytest.warns(UserWarning, match="cannot be cached"):
            found = planner(scenario)
    finally:
        jaxscp.use_cache(None)
    assert_same(found, expected)
    assert not cached_planners(tmp_path)


@pytest.mark.slow
def test_a_cache_is_filled_and_only_when_asked_for(tmp_path):
    program = (
        "import sys, jax, jaxscp\n"
        "assert jax.config.jax_compilation_cache_dir is None\n"
        "jax.numpy.ones(3) + 1\n"
        "jaxscp.use_cache(sys.argv[1])\n"
        "jax.jit(lambda x: x * 3 + 1)(jax.numpy.ones(3))\n"
    )
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    subprocess.run([sys.executable, "-c", program, tmp_path / "cache"], check=True, env=environment)
    assert any((tmp_path / "cache").iterdir())


@pytest.mark.nightly
def test_an_export_is_whole_though_its_programs_are_in_a_cache(tmp_path):
    """On the CPU, a program from JAX's cache lacks functions when stored again."""
    program = (
        "import sys, jax\n"
        "jax.config.update('jax_enable_x64', True)\n"
        "import jaxscp\n"
        "jaxscp.use_cache(sys.argv[1] + '/cache')\n"
        "scenario = jaxscp.scenarios.ascent_to_platform()\n"
        "planner = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=6), samples=20)\n"
        "expected = planner.compile(scenario)(scenario)\n"
        "planner.export(sys.argv[1] + '/planner', scenario)\n"
        "found = jaxscp.load(sys.argv[1] + '/planner', compile=False)(scenario)\n"
        "assert all((a == b).all() for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True))\n"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=True)
