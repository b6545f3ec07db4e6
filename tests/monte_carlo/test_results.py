"""Results of cases: other types, shapes and names than the base's are errors that name the case and the result."""

import concurrent.futures

import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp import monte_carlo as mc
from jaxscp.monte_carlo.outcome import outcome_of


def study(run, name="s", count=4):
    return mc.Study(run, {"s": 1.0}, [mc.Parameter("s", mc.Uniform(0, 0.9), name)], mc.Independent(count, 1))


def base_or(first, later):
    """The first value for the base, and the other for every case."""
    return lambda b: first if b["s"] == 1.0 else later


def path(array):
    return mc.Outcome({"a": 1.0}, {"p": array})


NAN = float("nan")
BASE = [
    ({"a": None, "b": 1.0}, "a is None"),
    ({"a": {"b": 1.0}, "a.b": 2.0}, "two results are called 'a.b'"),
    ({"a": "text"}, "a has the type <U4; results are numbers"),
    ({"a": object()}, "a has the type object; results are numbers"),
    ({"a": 2**70}, "a has the type object; results are numbers"),
    ({"a": np.zeros(2)}, r"a has the shape \(2,\); results are numbers"),
    ({}, "returned no numbers"),
    ({"success": NAN}, "success has the type float64; it must be True or False"),
    ({"success": 1}, "success has the type int64; it must be True or False"),
    ({"status": 0.0}, "status has the type float64; it must be a member of jaxscp.Status"),
    ({"status": 404}, "status is 404; it must be a member"),
    ({"status": -1}, "status is -1; it must be a member"),
    ({"m/s": 1.0}, "'m/s': no array can have this name"),
    ({"..": 1.0}, "'..': no array can have this name"),
    ({"__a": 1.0}, "'__a': no array can have this name"),
    ({"zarr.json": 1.0}, "'zarr.json': no array can have this name"),
    ({"case": 1.0}, "'case': the sweep itself uses this name"),
    ({"trajectory_stored": 1.0}, "'trajectory_stored': the sweep itself uses this name"),
    ({"trajectory.p": 1.0}, "'trajectory.p': the sweep itself uses this name"),
    (
        mc.Outcome({"a": 1.0}, {"p": np.zeros(2), "p_0": 1.0}),
        "'trajectory.p_0': the sweep itself uses this name",
    ),
    (mc.Outcome({"a": 1.0}, {"p": None}), "p is None"),
]


@pytest.mark.parametrize(("value", "message"), BASE, ids=[message for _, message in BASE])
def test_a_wrong_result_of_the_base_is_named(tmp_path, value, message):
    with pytest.raises(mc.SweepError, match=f"the base: (the result |run )?{message}"):
        mc.sweep(study(lambda b: value), tmp_path / "s")


LATER = [
    (
        {"n": 0},
        {"n": 1.5},
        r"n is 1.5 \(float64\); expected int64, as from the base. Return a float from the base too",
    ),
    ({"n": 0}, {"n": 2.0}, "expected int64"),
    ({"n": np.float32(1)}, {"n": 0.1}, r"n is 0.1 \(float64\); expected float32"),
    ({"n": 1.0}, {"n": True}, r"n is True \(bool\); expected float64"),
    ({"n": True}, {"n": 1}, r"n is 1 \(int64\); expected bool"),
    ({"n": 1.0}, {"n": 2**53 + 1}, r"n is 9007199254740993 \(int64\); expected float64"),
    ({"n": np.int8(1)}, {"n": 300}, r"n is 300 \(int64\); expected int8"),
    ({"success": True}, {"success": 0.3}, "expected bool, as from the base. It must be True or False"),
    ({"status": 0}, {"status": 404}, "status is 404; it must be a member"),
    ({"a": 1.0}, {"b": 1.0}, "the result a is missing"),
    ({"a": 1.0}, {"a": 1.0, "b": 1.0}, "the result b is new"),
    ({"a": 1.0}, {"a": None}, "a is None"),
    ({"a": 1.0}, {"a": "text"}, "a is text"),
    (
        path(np.zeros(3)),
        path(np.zeros(4)),
        r"trajectory.p has the shape \(4,\); expected \(3,\), as from the base",
    ),
    (path(np.zeros(3)), path(np.zeros(1)), r"trajectory.p has the shape \(1,\); expected \(3,\)"),
    (path(np.zeros(3, int)), path(np.zeros(3)), r"trajectory.p is \(float64\); expected int64"),
    (path(np.zeros(3)), mc.Outcome({"a": 1.0}), "the result trajectory.p is missing"),
]


@pytest.mark.parametrize(("first", "later", "message"), LATER, ids=[message for *_, message in LATER])
def test_a_result_that_is_not_the_bases_is_named(tmp_path, first, later, message):
    with pytest.raises(mc.SweepError, match=f"case 0: .*{message}"):
        mc.sweep(study(base_or(first, later)), tmp_path / "s", keep=mc.AllTrajectories())


@pytest.mark.parametrize(
    ("first", "later"),
    [(1.0, 3), (np.int32(1), 3), (3, np.int32(1)), (1.0, np.float32(0.5)), (np.uint8(1), 3)],
)
def test_equal_numbers_of_another_type_are_taken(tmp_path, first, later):
    found = mc.sweep(study(base_or({"n": first}, {"n": later})), tmp_path / "s")
    np.testing.assert_array_equal(found.values("n"), later)
    assert found.values("n").dtype == np.asarray(first).dtype
    assert mc.open_sweep(tmp_path / "s").complete == 4


def test_failures_of_the_base_and_of_a_case_are_named(tmp_path):
    with pytest.raises(mc.SweepError, match="the base: run failed, ZeroDivisionError"):
        mc.sweep(study(lambda b: 1 / 0), tmp_path / "s")
    with pytest.raises(mc.SweepError, match="case 0: run failed, ZeroDivisionError"):
        mc.sweep(study(lambda b: {"a": 1.0 if b["s"] == 1.0 else 1 / 0}), tmp_path / "s")


def test_statuses_are_taken(tmp_path):
    found = mc.sweep(study(lambda b: {"status": jaxscp.Status.infeasible}), tmp_path / "s")
    assert found.dataset()["status"].values.tolist() == ["infeasible"] * 4


@pytest.mark.parametrize("name", ["N/kg", "..", "__a"])
def test_a_parameter_has_the_name_of_an_array(tmp_path, name):
    with pytest.raises(mc.InvalidStudy, match="no array can have the name"):
        mc.sweep(study(lambda b: {"a": 1.0}, name), tmp_path / "s")


@pytest.mark.parametrize(
    ("run", "message"),
    [
        (lambda b: {"a": 1.0 if b["s"] > 0.5 else 2.0}, "the base: run failed, TracerBoolConversionError"),
        (lambda b: {"success": b["s"]}, "the base: success has the type float"),
        (lambda b: {"a": None}, "the base: a is None"),
        (lambda b: {"status": jnp.where(b["s"] > 0.5, 404, 0)}, r"case \d: status is 404"),
    ],
)
def test_many_at_once_are_checked_alike(tmp_path, run, message):
    with pytest.raises(mc.SweepError, match=message):
        mc.sweep(study(run), tmp_path / "s", engine=mc.InProcess(mc.Together(4)))


def test_results_of_one_engine_fit_those_of_another(tmp_path):
    def run(b):
        return {"a": 2.0 * b["s"], "n": 3}

    first = mc.sweep(study(run), tmp_path / "s", stop=(mc.Budget(1e-9),), chunk=2)
    assert first.complete == 2
    whole = mc.sweep(study(run), tmp_path / "s", engine=mc.InProcess(mc.Together(2)))
    np.testing.assert_array_equal(whole.values("n"), 3)
    np.testing.assert_allclose(
        whole.values("a"), 2.0 * whole.values("s"), rtol=1e-6
    )  # float32 in tests without x64


def test_a_named_number_has_its_name_alone():
    with pytest.raises(mc.InvalidStudy, match="the result is None"):
        outcome_of(None)
    assert outcome_of(1.0).scalars == {"value": 1.0}


def test_a_worker_that_ends_on_the_base_is_named(tmp_path):
    class Broken:
        def submit(self, *arguments):
            raise concurrent.futures.BrokenExecutor

    with pytest.raises(mc.SweepError, match="a worker process ended"):
        mc.sweep(study(lambda b: {"a": 1.0}), tmp_path / "s", engine=mc.Workers(Broken()))
