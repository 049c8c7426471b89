"""An IMU and an antenna two metres from it, driven along a path that is known."""

import numpy as np

GRAVITY = np.array([0.0, 0.0, 9.81])
LEVER_ARM = np.array([2.0, -1.0, 0.5])
R_B_I = np.array([[0.0, -0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.8, 0.6]])  # a mount that nobody would guess
VELOCITIES, POSITIONS = 1, 2
SECONDS = 110.0


def turning(t):
    """Position of the IMU (N, 3), yaw and roll: bends, hills and changes of speed."""
    p = np.stack([40 * np.sin(0.11 * t) + 3 * np.sin(0.7 * t), 30 * np.cos(0.17 * t), np.sin(0.2 * t)], axis=1)
    return p, 0.5 * np.sin(0.3 * t) + 0.2 * t, 0.02 * np.sin(1.1 * t)


def straight(t):
    """An even road along x: speed changes, heading does not."""
    return np.stack([5 * t + 6 * np.sin(0.6 * t), 0 * t, 0 * t], axis=1), 0 * t + 0.7, 0.01 * np.sin(1.3 * t)


def standing(t):
    return np.zeros((len(t), 3)), 0 * t, 0 * t


def attitudes(yaw, roll):
    zero, one = 0 * yaw, 0 * yaw + 1
    cy, sy, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(roll), np.sin(roll)
    yawed = np.array([[cy, -sy, zero], [sy, cy, zero], [zero, zero, one]])
    rolled = np.array([[one, zero, zero], [zero, cr, -sr], [zero, sr, cr]])
    return np.einsum("ijn,jkn,kl->nil", yawed, rolled, R_B_I)


def driven(motion, seed=0):
    """Return stamps and readings of an IMU at 100 Hz, with biases and noise."""
    rng, t, h = np.random.default_rng(seed), np.arange(0.0, SECONDS, 0.01), 1e-4
    before, now, after = (motion(t + k * h) for k in (-1, 0, 1))
    R = attitudes(*now[1:])
    turned = np.einsum("nji,njk->nik", attitudes(*before[1:]), attitudes(*after[1:])) / (2 * h)
    rate = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=1)
    acceleration = (after[0] - 2 * now[0] + before[0]) / h**2
    force = np.einsum("nji,nj->ni", R, acceleration + GRAVITY)
    bias = np.r_[0.01, -0.005, 0.008, 0.1, -0.05, 0.08]
    noise = rng.normal(size=(len(t), 6)) * np.repeat([0.01, 0.1], 3)
    return t, np.concatenate([rate, force], axis=1) + bias + noise


def received(motion, order, sigma, stamps_early_s, rate_hz, seed=0):  # noqa: PLR0917 (what a receiver is like)
    """Return stamps and the positions or velocities of an antenna two metres from the IMU."""
    rng, t = np.random.default_rng(100 + seed), np.arange(0.0, SECONDS, 1.0 / rate_hz)

    def antenna(at):
        p, yaw, roll = motion(at)
        return p + attitudes(yaw, roll) @ LEVER_ARM

    values = antenna(t) if order == POSITIONS else (antenna(t + 1e-4) - antenna(t - 1e-4)) / 2e-4
    return t - stamps_early_s, values + rng.normal(size=values.shape) * sigma
