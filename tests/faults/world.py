"""A world with a truth: a pattern on a wall that swings sideways, and a camera that looks at it.

The pattern swings so that the error is never zero: while a task servos, every twist moves, and a twist that should not have
come is never hidden by being zero anyway.
"""

import math

import numpy as np

WIDTH, HEIGHT, FOCAL_PX, DEPTH_M = 160, 120, 150.0, 1.0
# Metres and seconds of the pattern's swing: at most 0.06 m/s, well below the limit of 0.2 m/s.
SWING_M, SWING_S = (0.040, 0.025), (4.0, 5.5)
# The pattern continues beyond the picture by so many pixels on each side.
MARGIN = 60

CAMERA = {
    "fx": FOCAL_PX,
    "fy": FOCAL_PX,
    "cx": (WIDTH - 1) / 2,
    "cy": (HEIGHT - 1) / 2,
    "width": WIDTH,
    "height": HEIGHT,
}


def settings(**changes):
    """A task that follows the pattern sideways and never arrives, 20 frames a second."""
    made = {
        "camera": CAMERA,
        "depth": {"constant_m": DEPTH_M},
        "degrees_of_freedom": [True, True, False, False, False, False],
        "frame_period_s": 0.05,
        "frames": "pushed",
        "stop": {"step_m": 1e-9, "step_rad": 1e-9, "hold_frames": 10000},
    }
    return {**made, **changes}


def pattern():
    """Gray 0 to 255, smooth, black towards the borders: spots and waves."""
    height, width = HEIGHT + 2 * MARGIN, WIDTH + 2 * MARGIN
    v, u = np.mgrid[0:height, 0:width].astype(float)
    x, y = u - (width - 1) / 2, v - (height - 1) / 2
    gray = 0.25 + 0.12 * np.cos(x / 9.0 + y / 21.0) + 0.12 * np.cos(y / 8.0 - x / 26.0)
    for spot_x, spot_y, radius in [(-30, -10, 12), (17, 15, 10), (25, -17, 15), (-12, 20, 11)]:
        gray += 0.5 * np.exp(-((x - spot_x) ** 2 + (y - spot_y) ** 2) / (2 * radius**2))
    return 230 * np.exp(-((x / 55) ** 4) - (y / 42) ** 4) * np.clip(gray, 0, 1)


PATTERN = pattern()


def picture(shift_m, noise=None):
    """What the camera sees when the pattern lies `shift_m` (x, y) off its axis: bytes, one for each pixel. `noise`: an image to add."""
    u, v = (MARGIN - shift * FOCAL_PX / DEPTH_M for shift in shift_m)
    u, v = min(max(u, 0.0), 2 * MARGIN - 1.0), min(max(v, 0.0), 2 * MARGIN - 1.0)
    iu, iv = int(u), int(v)
    fu, fv = u - iu, v - iv
    part = PATTERN[iv : iv + HEIGHT + 1, iu : iu + WIDTH + 1]
    rows = part[:-1] * (1 - fv) + part[1:] * fv
    gray = rows[:, :-1] * (1 - fu) + rows[:, 1:] * fu
    if noise is not None:
        gray = gray + noise
    return np.clip(gray + 0.5, 0, 255).astype(np.uint8).tobytes()


def swing(seconds):
    """Where the pattern is, metres."""
    return tuple(size * math.sin(2 * math.pi * seconds / period) for size, period in zip(SWING_M, SWING_S))
