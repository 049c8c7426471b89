"""The odometry frame O: T_W_O takes every correction of the world pose, so that T_O_I never jumps."""

import gtsam


class OdometryFrame:
    """Keeps T_O_I continuous over corrections of T_W_I: Eq. (11) of the paper, applied at every correction."""

    def __init__(self) -> None:
        self.T_W_O = gtsam.Pose3()

    def correct(self, before: gtsam.Pose3 | None, after: gtsam.Pose3) -> None:
        """Take in that T_W_I went from `before` to `after` at one instant; `before` is None at the first state."""
        if before is not None:
            self.T_W_O = after * before.inverse() * self.T_W_O
