"""Where things sit: rigid transforms between named frames, and the turn joint."""

from typing import Self

import numpy as np
from pydantic import Field, model_validator

from holdfast.config.section import Section, Vector3, quantity
from holdfast.messages import Array

MAX_MOUNT_M = 1000.0  # no machine is larger
FULL_CIRCLE_DEG = 360.0


class Extrinsic(Section):
    """T_parent_child: the pose of the child frame in the parent frame. Give one form of rotation, or none."""

    parent: str = Field(description="name of the frame in which the pose is given")
    child: str = Field(description="name of the frame whose pose is given")
    translation_m: Vector3 = quantity("m", (0.0, 0.0, 0.0), doc="origin of the child in the parent: x, y, z")
    rotation_quaternion_xyzw: tuple[float, float, float, float] | None = Field(None, description="x, y, z, w")
    rotation_matrix: tuple[Vector3, Vector3, Vector3] | None = Field(None, description="rows of R_parent_child")
    rotation_rpy_deg: Vector3 | None = quantity("deg", None, doc="fixed-axis roll, pitch, yaw, as in URDF")

    @model_validator(mode="after")
    def _check_rotation(self) -> Self:
        forms = (self.rotation_quaternion_xyzw, self.rotation_matrix, self.rotation_rpy_deg)
        if sum(form is not None for form in forms) > 1:
            raise ValueError("give only one of rotation_quaternion_xyzw, rotation_matrix, rotation_rpy_deg")
        if self.rotation_quaternion_xyzw is not None:
            norm = float(np.linalg.norm(self.rotation_quaternion_xyzw))
            if abs(norm - 1.0) > 1e-3:
                raise ValueError(f"rotation_quaternion_xyzw has norm {norm:.6g}: must be 1 (order is x, y, z, w)")
        if self.rotation_matrix is not None:
            R = np.array(self.rotation_matrix)
            if not np.allclose(R @ R.T, np.eye(3), atol=1e-4) or np.linalg.det(R) < 0:
                raise ValueError("rotation_matrix is not a rotation: rows must be orthonormal, determinant +1")
        return self

    @model_validator(mode="after")
    def _check_size(self) -> Self:
        if max(map(abs, self.translation_m)) > MAX_MOUNT_M:
            raise ValueError(f"translation_m: must be within +-{MAX_MOUNT_M:g} m, on one machine")
        if self.rotation_rpy_deg is not None and max(map(abs, self.rotation_rpy_deg)) > FULL_CIRCLE_DEG:
            raise ValueError(f"rotation_rpy_deg: must be within +-{FULL_CIRCLE_DEG:g} deg")
        return self

    def matrix(self) -> Array:
        """Return T_parent_child as a (4, 4) homogeneous matrix [m]; the rotation is projected onto SO(3)."""
        T = np.eye(4)
        T[:3, :3] = self._rotation()
        T[:3, 3] = self.translation_m
        return T

    def _rotation(self) -> Array:
        from gtsam import SO3, Rot3  # `holdfast config` need not wait for it where nothing is turned

        if self.rotation_matrix is not None:
            return np.asarray(SO3.ClosestTo(np.array(self.rotation_matrix)).matrix())
        if self.rotation_quaternion_xyzw is not None:
            x, y, z, w = np.array(self.rotation_quaternion_xyzw) / np.linalg.norm(self.rotation_quaternion_xyzw)
            return np.asarray(Rot3.Quaternion(w, x, y, z).matrix())
        if self.rotation_rpy_deg is not None:
            return np.asarray(Rot3.RzRyRx(*np.radians(self.rotation_rpy_deg)).matrix())
        return np.eye(3)


class TurnJointConfig(Extrinsic):
    """How the cabin sits on the chassis while the turn joint reads zero; it turns about the z axis of `parent`."""

    parent: str = Field("base_link", description="frame on the side of the chassis: its z axis is that of the joint")
    child: str = Field(description="frame on the side of the cabin, its origin on the axis")
