import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation, Slerp

from holdfast.evaluation import quaternions

rotations = arrays(float, (3,), elements=st.floats(-4.0, 4.0)).map(Rotation.from_rotvec)
vectors = arrays(float, (3,), elements=st.floats(-100.0, 100.0))


@given(rotations, rotations, vectors)
def test_product_and_rotation_agree_with_scipy(a, b, v):
    product = quaternions.multiply(a.as_quat(), b.as_quat())
    np.testing.assert_allclose(Rotation.from_quat(product).as_matrix(), (a * b).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(quaternions.rotate(a.as_quat(), v), a.apply(v), atol=1e-12)


@given(rotations, rotations, st.floats(0.0, 1.0))
def test_slerp_agrees_with_scipy(a, b, fraction):
    if (a.inv() * b).magnitude() > np.pi - 1e-6:
        return  # both arcs are equally short
    ours = quaternions.slerp(a.as_quat(), b.as_quat(), np.array(fraction))
    theirs = Slerp([0.0, 1.0], Rotation.concatenate([a, b]))(fraction)
    assert (Rotation.from_quat(ours).inv() * theirs).magnitude() < 1e-7
    assert abs(np.linalg.norm(ours) - 1.0) < 1e-14


@given(rotations)
def test_angle_and_its_sign_of_quaternion_do_not_matter(a):
    assert abs(quaternions.angle_rad(a.as_quat()) - a.magnitude()) < 1e-14
    assert quaternions.angle_rad(-a.as_quat()) == quaternions.angle_rad(a.as_quat())


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_roll_pitch_yaw_come_back_from_the_rotation(roll, pitch, yaw):
    q = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    np.testing.assert_allclose(quaternions.roll_pitch_yaw_rad(q), [roll, pitch, yaw], atol=1e-12)


@given(st.floats(-100.0, 100.0))
def test_wrapped_angles_are_the_same_angle_within_half_a_turn(angle):
    wrapped = quaternions.wrap_rad(np.array(angle))
    assert -np.pi <= wrapped < np.pi
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angle), atol=1e-13)
