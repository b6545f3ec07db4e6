"""Invalid input raises an error with the field's name before compilation; in a batch it has its own status."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp import InvalidScenario, Status
from jaxscp.solver import pipeline

NODES = 20


@pytest.fixture(scope="module")
def scenario():
    return jaxscp.scenarios.ascent_to_platform()


@pytest.fixture(autouse=True)
def _nothing_may_compile(request, monkeypatch):
    if "batch" in request.node.name:
        return

    def compiled(*args):
        raise AssertionError("the planner was compiled before its input was checked")

    monkeypatch.setattr(pipeline, "_setup", compiled)


def far(corridor):
    return corridor.offsets.at[1].add(corridor.normals[1] @ jnp.array([50.0, 0.0, 0.0]))


BAD = {
    "mass zero": (lambda s: s.airframe.body.mass, lambda v: v * 0.0, "airframe.body.mass"),
    "mass negative": (lambda s: s.airframe.body.mass, lambda v: -v, "airframe.body.mass"),
    "mass NaN": (lambda s: s.airframe.body.mass, lambda v: v * jnp.nan, "airframe.body.mass"),
    "infinite offset": (lambda s: s.corridor.offsets, lambda v: v.at[0, 0].set(jnp.inf), "corridor.offsets"),
    "NaN obstacle": (lambda s: s.obstacles, lambda v: v.at[0, 0].set(jnp.nan), "obstacles"),
    "start outside": (lambda s: s.start.position, lambda v: v - 9.0, "start.position"),
    "goal outside": (lambda s: s.goal.position, lambda v: v + 9.0, "goal.position"),
    "disjoint": (lambda s: s.corridor.offsets, None, "corridor.joints"),
    "empty": (lambda s: s.corridor.offsets, lambda v: v.at[0, 0].set(-50.0), "start.position"),
    "unbounded": (lambda s: s.corridor.normals, lambda v: v.at[1, 2].set(0.0), "corridor.normals"),
    "limits crossed": (lambda s: s.airframe.thrust_min, lambda v: v + 9.0, "airframe.thrust_min"),
    "inertia": (lambda s: s.airframe.body.inertia, lambda v: v.at[0, 0].set(-1.0), "airframe.body.inertia"),
    "inertia in g m^2": (lambda s: s.airframe.body.inertia, lambda v: v * 1e3, "airframe.body.inertia"),
    "inertia in g cm^2": (lambda s: s.airframe.body.inertia, lambda v: v * 1e7, "airframe.body.inertia"),
    "quaternion": (lambda s: s.start.attitude, lambda v: v * 2.0, "start.attitude"),
    "cannot hover": (lambda s: s.airframe.thrust_max, lambda v: v * 0.2, "airframe"),
    "cone in degrees": (lambda s: s.cone_angle, lambda v: v * 57.0, "cone_angle"),
    "dilation": (lambda s: s.dilation_min, lambda v: v + 90.0, "dilation_min"),
    "weights": (lambda s: s.weights.control, lambda v: -v, "weights"),
    "shape of start": (lambda s: s.start.position, lambda v: v[:2], "start.position"),
    "shape of faces": (lambda s: s.corridor.normals, lambda v: v[:, :3], "corridor.normals"),
    "float32": (lambda s: s.goal.position, lambda v: v.astype(jnp.float32), "goal.position"),
}


@pytest.mark.parametrize("name", BAD)
def test_error_names_the_field(scenario, name):
    where, change, field = BAD[name]
    value = far(scenario.corridor) if change is None else change(where(scenario))
    with jax.disable_jit(False), pytest.raises(InvalidScenario, match=field.replace(".", r"\.")):
        jaxscp.Planner(nodes=NODES)(eqx.tree_at(where, scenario, value))


ball = jaxscp.ellipsoids
BAD_PARTS = {
    "speed": ({"limits": jaxscp.flight_limits(speed=-1.0)}, "limits.speed"),
    "tilt in degrees": ({"limits": jaxscp.flight_limits(tilt=30.0)}, "limits.tilt"),
    "NaN limit": ({"limits": jaxscp.flight_limits(body_rate=float("nan"))}, "limits.body_rate"),
    "start in zone": ({"keep_out": ball([[0.0, 0.0, 1.0]], 0.5)}, "start.position"),
    "flat zone": ({"keep_out": ball([[2.0, 2.0, 1.5]], [[0.1, 0.1, np.inf]])}, "keep_out.shapes"),
    "gate elsewhere": ({"gates": ball([[90.0, 0.0, 1.0]], 0.5)}, "gates.centres"),
    "too many gates": ({"gates": ball([[1.5, 2.0, 1.5]] * 19, 0.5)}, "gates"),
    "deck": ({"deck_velocity": jnp.array([1.0, jnp.inf, 0.0])}, "deck_velocity"),
    "deck leaves": ({"deck_velocity": jnp.array([40.0, 0.0, 0.0])}, "deck_velocity"),
    "half fixed": ({"goal_fixed": jaxscp.fixed(velocity=0.5)}, "goal_fixed.velocity"),
}


@pytest.mark.parametrize("name", BAD_PARTS)
def test_error_names_the_optional_part(scenario, name):
    change, field = BAD_PARTS[name]
    with pytest.raises(InvalidScenario, match=field.replace(".", r"\.")):
        jaxscp.Planner(nodes=NODES)(dataclasses.replace(scenario, **change))


def test_a_flight_that_takes_too_long_is_refused(scenario):
    way = float(jnp.linalg.norm(scenario.goal.position - scenario.start.position))
    least = way / float(scenario.dilation_max)  # m/s
    for factor, refused in ((0.9, True), (1.1, False)):
        slow = dataclasses.replace(scenario, limits=jaxscp.flight_limits(speed=factor * least))
        if refused:
            with pytest.raises(jaxscp.InvalidScenario, match=r"dilation_max: at limits\.speed"):
                jaxscp.validate(slow)
        else:
            jaxscp.validate(slow)


def test_start_beyond_a_limit(scenario):
    fast = eqx.tree_at(lambda s: s.start.velocity, scenario, jnp.array([3.0, 0.0, 0.0]))
    with pytest.raises(InvalidScenario, match=r"start\.velocity"):
        jaxscp.Planner(nodes=NODES)(dataclasses.replace(fast, limits=jaxscp.flight_limits(speed=2.0)))


@pytest.mark.parametrize(("nodes", "field"), [(1, "nodes"), (0, "nodes"), (3, "corridor")])
def test_too_few_nodes(scenario, nodes, field):
    with pytest.raises(InvalidScenario, match=field):
        jaxscp.Planner(nodes=nodes)(scenario)


def test_single_precision_is_refused(scenario):
    with jax.enable_x64(False), pytest.raises(InvalidScenario, match="jax_enable_x64"):
        jaxscp.Planner(nodes=NODES)(scenario)


@pytest.mark.parametrize(
    "mission", [jaxscp.scenarios.platform_to_platform, jaxscp.scenarios.ascent_to_platform]
)
def test_shipped_missions_are_valid(mission):
    jaxscp.validate(mission(), 30)


VEHICLES = {  # mass kg, principal moments kg m^2, arm m
    "30 g": (0.03, [1.7e-5, 1.7e-5, 3.0e-5], 0.046),
    "heavy middle": (1.4, [5e-3, 5e-3, 6e-3], 0.35),
    "200 kg": (200.0, [60.0, 90.0, 140.0], 2.2),
    "ring": (2.0, [0.08, 0.08, 0.16], 0.28),
}


@pytest.mark.parametrize("name", VEHICLES)
def test_an_inertia_of_a_real_vehicle_is_taken(scenario, name):
    mass, inertia, arm = VEHICLES[name]
    thrusts = {"thrust_min": 0.0, "thrust_max": 9.0 * mass}
    frame = jaxscp.airframes.multirotor(mass=mass, inertia=inertia, arm=arm, torque_ratio=0.01, **thrusts)
    jaxscp.validate(dataclasses.replace(scenario, airframe=frame))


def test_an_inertia_that_no_body_has_is_warned_of(scenario):
    moments = jnp.diag(jnp.array([2.5e-3, 2.1e-3, 9e-3]))
    odd = eqx.tree_at(lambda s: s.airframe.body.inertia, scenario, moments)
    with pytest.warns(UserWarning, match=r"airframe\.body\.inertia: no body has the principal moments"):
        jaxscp.validate(odd)


def test_a_quaternion_off_unit_norm_comes_with_its_remedy(scenario):
    odd = eqx.tree_at(lambda s: s.start.attitude, scenario, 1.017 * scenario.start.attitude)
    with pytest.raises(InvalidScenario, match=r"norm 1\.017, .* q / np\.linalg\.norm\(q\)"):
        jaxscp.validate(odd)
    unit = odd.start.attitude / np.linalg.norm(odd.start.attitude)
    jaxscp.validate(eqx.tree_at(lambda s: s.start.attitude, odd, unit))


@pytest.mark.slow
def test_bad_element_of_a_batch_gets_a_status_and_harms_no_other(scenario):
    """Batch elements 1 and 2 are invalid, with NaN for numbers; elements 0 and 3 must not be affected."""
    batch = jax.tree.map(lambda v: jnp.stack([v] * 4), scenario)
    heavier = batch.airframe.body.mass * jnp.array([1.0, 1.0, 1.0, 1.1])
    well = eqx.tree_at(lambda s: s.airframe.body.mass, batch, heavier)
    broken = eqx.tree_at(lambda s: s.airframe.body.mass, well, heavier.at[1].set(jnp.nan))
    broken = eqx.tree_at(lambda s: s.start.position, broken, broken.start.position.at[2].add(50.0))
    plan = jax.jit(jax.vmap(jaxscp.Planner(nodes=NODES, method=jaxscp.PTR())))
    expected, found = plan(well), plan(broken)
    assert np.all(expected.status == Status.converged)
    assert list(jaxscp.status_names(found.status)) == [
        "converged",
        "invalid_input",
        "invalid_input",
        "converged",
    ]
    for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        if jnp.issubdtype(b.dtype, jnp.inexact):
            assert np.isnan(b[jnp.array([1, 2])]).all()
            assert np.isfinite(b[jnp.array([0, 3])]).all()
        np.testing.assert_array_equal(a[jnp.array([0, 3])], b[jnp.array([0, 3])])
