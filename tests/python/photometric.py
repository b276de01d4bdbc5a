"""The photometric law in a few lines of numpy: what the service must answer to a pair of pictures, to the rounding of its
single precision. Knows the equations and nothing of this project's code."""

import numpy as np

import first_client

# Planes of 32 bits (6e-8 a pixel), a condition number of some hundreds.
TOLERANCE = 3e-4


def interaction(gray, focal_px, depth_m):
    """Row i: how pixel i's gray changes under a camera twist, for pixels with the principal point in the middle."""
    height, width = gray.shape
    v, u = np.mgrid[0:height, 0:width]
    x, y = (u - (width - 1) / 2) / focal_px, (v - (height - 1) / 2) / focal_px
    down, right = np.gradient(gray)
    z, zero = np.full_like(x, 1 / depth_m), np.zeros_like(x)
    x_dot = np.stack([-z, zero, x * z, x * y, -(1 + x * x), y], axis=-1)
    y_dot = np.stack([zero, -z, y * z, 1 + y * y, -x * y, -x], axis=-1)
    return (-focal_px * (right[..., None] * x_dot + down[..., None] * y_dot)).reshape(-1, 6)


def twist(desired, current, focal_px, depth_m, gain_per_s):
    """-gain times the least-squares solution, with the mean of both pictures' interaction matrices."""
    mean = (interaction(desired, focal_px, depth_m) + interaction(current, focal_px, depth_m)) / 2
    solution, *_ = np.linalg.lstsq(mean, (current - desired).ravel(), rcond=None)
    return -gain_per_s * solution


def check(endpoint):
    """The service's photometric twist is this one; its order is 0 and its features are as many as 16 bits can say."""
    settings = {
        "method": "photometric",
        "degrees_of_freedom": [True] * 6,
        "limits": "none",
        "step_cap": "none",
        "lease": "none",
    }
    with first_client.open_session(endpoint) as session:
        answer = first_client.servo_once(session, "domvs", "photometric", settings)
    pictures = [first_client.picture(0, 0), first_client.picture(*first_client.SHIFT_PX)]
    desired, current = (np.rint(picture * 255) / 255 for picture in pictures)
    gain = first_client.STEP_FRACTION / first_client.FRAME_PERIOD_S
    expected = twist(desired, current, first_client.FOCAL_PX, first_client.DEPTH_M, gain)
    error = np.linalg.norm(answer["twist"] - expected) / np.linalg.norm(expected)
    print(f"        off by {error:.1e} of the twist")
    assert error <= TOLERANCE, f"expected {expected.tolist()}, got {answer['twist']}"
    assert (answer["order"], answer["features"]) == (0, 65535), answer
    mse = np.mean((current - desired) ** 2)
    assert abs(answer["pixel_mse"] - mse) <= TOLERANCE * mse, f"expected {mse}, got {answer['pixel_mse']}"
