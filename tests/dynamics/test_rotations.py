"""Quaternion algebra against SciPy's, and the identities that the solver relies on."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jaxscp.dynamics import rotations

ROUNDING = 1e-13  # a handful of operations on numbers of size one

number = st.floats(-1.0, 1.0, allow_nan=False)
vectors = st.tuples(number, number, number).map(np.array)


@st.composite
def quaternions(draw):
    q = np.array(draw(st.tuples(number, number, number, number)))
    assume(np.linalg.norm(q) > 0.1)
    return jnp.asarray(q / np.linalg.norm(q))


def scipy_rotation(q) -> Rotation:
    return Rotation.from_quat(np.asarray(q)[[1, 2, 3, 0]])


few = settings(max_examples=25, deadline=None)


@few
@given(quaternions())
def test_rotation_matrix_is_scipys(q):
    np.testing.assert_allclose(rotations.rotation_matrix(q), scipy_rotation(q).as_matrix(), atol=ROUNDING)


@few
@given(quaternions())
def test_rotation_matrix_is_orthogonal_and_proper(q):
    matrix = np.asarray(rotations.rotation_matrix(q))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=ROUNDING)
    np.testing.assert_allclose(np.linalg.det(matrix), 1.0, atol=ROUNDING)


@few
@given(quaternions(), quaternions())
def test_product_of_quaternions_is_product_of_matrices(a, b):
    both = rotations.rotation_matrix(rotations.multiply(a, b))
    one_by_one = rotations.rotation_matrix(a) @ rotations.rotation_matrix(b)
    np.testing.assert_allclose(both, one_by_one, atol=ROUNDING)


@few
@given(quaternions())
def test_conjugate_undoes(q):
    identity = rotations.multiply(rotations.conjugate(q), q)
    np.testing.assert_allclose(identity, [1.0, 0.0, 0.0, 0.0], atol=ROUNDING)


@few
@given(quaternions(), vectors)
def test_attitude_rate_turns_the_body_axes(q, body_rate):
    """dR/dt = R [w]x along the quaternion's rate, and |q| is constant."""
    rate = rotations.quaternion_rate(q, jnp.asarray(body_rate))
    _, turning = jax.jvp(rotations.rotation_matrix, (q,), (rate,))
    cross = np.cross(np.eye(3), body_rate)  # row i: e_i x w, so this is [w]x
    np.testing.assert_allclose(turning, np.asarray(rotations.rotation_matrix(q)) @ cross, atol=ROUNDING)
    np.testing.assert_allclose(jnp.dot(q, rate), 0.0, atol=ROUNDING)


@few
@given(quaternions(), quaternions())
def test_angle_between_is_scipys_whatever_the_signs(a, b):
    angle = (scipy_rotation(a).inv() * scipy_rotation(b)).magnitude()
    for q in (b, -b):
        np.testing.assert_allclose(rotations.angle_between(a, q), angle, atol=1e-7)  # arctan of a square root


@few
@given(quaternions(), vectors)
def test_attitude_error_is_half_the_rotation_vector(target, direction):
    small = 1e-4 * direction
    turned = rotations.multiply(target, jnp.asarray(Rotation.from_rotvec(small).as_quat()[[3, 0, 1, 2]]))
    for q in (turned, -turned):  # both signs are the same attitude
        np.testing.assert_allclose(rotations.attitude_error(q, target), small / 2, atol=1e-12)


def test_a_level_vehicles_thrust_does_not_lengthen_with_the_quaternion():
    """Linearised steps let |q| drift; the chosen polynomial must not convert the drift into thrust."""
    stretched = rotations.rotation_matrix(jnp.array([1.3, 0.0, 0.0, 0.0]))
    np.testing.assert_array_equal(stretched, np.eye(3))


@pytest.mark.parametrize("yaw", [-3.0, -0.5, 0.0, 1.0, 3.1])
def test_heading(yaw):
    q = rotations.from_yaw(yaw)
    np.testing.assert_allclose(
        rotations.rotation_matrix(q) @ jnp.array([1.0, 0.0, 0.0]), [np.cos(yaw), np.sin(yaw), 0.0], atol=1e-15
    )
    assert float(rotations.tilt(q)) < 1e-7  # resolution of arccos near one


def test_tilt_of_a_known_lean():
    lean = jnp.asarray(Rotation.from_euler("zy", [0.7, 0.4]).as_quat()[[3, 0, 1, 2]])
    np.testing.assert_allclose(rotations.tilt(lean), 0.4, atol=ROUNDING)
