"""A Domvs client that knows only the protocol: `struct` and `eclipse-zenoh`, nothing of this project.

It makes a picture out of cosines and bumps, and the same picture a few pixels further right and down. The first is the target,
the second the current image, so the camera has to move right and down: a twist that can be said in advance. It prints one JSON
object with the twist and that expectation, and exits 0 only when they agree.

    pip install eclipse-zenoh==1.10.2 numpy
    python first_client.py --endpoint tcp/127.0.0.1:7447
"""

import argparse
import json
import math
import struct
import sys
import time

import numpy as np
import zenoh

# Frame header, little-endian: version, pixel format, depth format, flags; width, height, row bytes, depth offset;
# metres per count; sequence, capture time in ns; deadline in µs, reserved.
FRAME = struct.Struct("<BBBBIIIIfQQII")
# Twist: version, status; flags, order, features; sequence, capture time; epoch, queue, compute, valid; twist;
# pixel mse, feature error norm, condition number; gain; eight bytes of padding.
TWIST = struct.Struct("<BBHHHQQIIII6d3dd8x")
assert FRAME.size == 48 and TWIST.size == 128

VERSION = 1
MONO8 = 1
NO_DEPTH = 0
SECRET_FOLLOWS = 1
SERVOING = 0

WIDTH, HEIGHT = 320, 240
FOCAL_PX = 300.0
DEPTH_M = 1.0
SHIFT_PX = (3.0, 2.0)
STEP_FRACTION = 0.5
FRAME_PERIOD_S = 0.1
# Gauss-Newton is exact to first order in the shift: 0.3 % were left of the second order, and of 8-bit rounding.
TOLERANCE = 0.03


class NoAnswer(Exception):
    """Silence: nobody there, access refused, or too late. It means: no twist, brake."""


class Refused(Exception):
    """The service said no, with a frozen word and a sentence."""


def picture(shift_u, shift_v):
    """Gray in [0, 1], smooth, black towards the border, the pattern `shift` pixels right and down of where it was."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    x, y = u - shift_u - (WIDTH - 1) / 2, v - shift_v - (HEIGHT - 1) / 2
    waves = 0.5 + 0.2 * np.cos(x / 19.0 + y / 41.0) + 0.2 * np.cos(y / 17.0 - x / 53.0)
    bumps = np.zeros_like(x)
    for bump_x, bump_y, radius in [(-60, -20, 25), (35, 30, 20), (50, -35, 30), (-25, 40, 22)]:
        bumps += np.exp(-((x - bump_x) ** 2 + (y - bump_y) ** 2) / (2 * radius**2))
    fading = np.exp(-((x / 90.0) ** 4) - (y / 70.0) ** 4)
    return np.clip(fading * (0.6 * waves + 0.35 * bumps), 0.0, 1.0)


def pixels(gray):
    return np.rint(gray * 255).astype(np.uint8).tobytes()


def frame_header(sequence, capture_time_ns, secret, deadline_us=0):
    header = FRAME.pack(
        VERSION, MONO8, NO_DEPTH, SECRET_FOLLOWS, WIDTH, HEIGHT, 0, 0, 0.0, sequence, capture_time_ns, deadline_us, 0
    )
    return header + secret


def read_twist(payload):
    """The twist of 128 bytes, or an error: what is not clearly an order to move must not move anything."""
    if len(payload) != TWIST.size:
        raise ValueError(f"a twist has {TWIST.size} bytes, got {len(payload)}")
    fields = TWIST.unpack(payload)
    if fields[0] != VERSION:
        raise ValueError(f"expected wire version {VERSION}, got {fields[0]}")
    names = ("status", "flags", "order", "features", "sequence", "capture_time_ns")
    names += ("epoch", "queue_us", "compute_us", "valid_ms")
    twist = dict(zip(names, fields[1:11]))
    twist["twist"] = list(fields[11:17])
    diagnostics = ("pixel_mse", "feature_error_norm", "condition_number", "gain_per_s")
    twist.update({name: None if math.isnan(value) else value for name, value in zip(diagnostics, fields[17:21])})
    if twist["status"] != SERVOING and any(twist["twist"]):
        raise ValueError(f"status {twist['status']} came with motion {twist['twist']}")
    if not all(map(math.isfinite, twist["twist"])):
        raise ValueError(f"a twist is finite, got {twist['twist']}")
    return twist


def open_session(endpoint):
    config = zenoh.Config()
    settings = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": 5000,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": 1000,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def ask(session, key, payload=b"", attachment=None, encoding="application/json", timeout_s=2.0):
    """The first answer on a key. An empty end is asked again until the timeout: right after connecting it is common."""
    deadline = time.monotonic() + timeout_s
    while (left := deadline - time.monotonic()) > 0:
        for reply in session.get(key, payload=payload, attachment=attachment, encoding=encoding, timeout=left):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
            text = reply.err.payload.to_bytes()
            if text == b"Timeout":
                raise NoAnswer(f"no answer on {key} within {timeout_s} s")
            refusal = json.loads(text)
            raise Refused(f"{key}: {refusal['code']}: {refusal['error']}")
        time.sleep(0.02)
    raise NoAnswer(f"nobody answers on {key} within {timeout_s} s")


def least_loaded_worker(session, prefix, timeout_s=3.0):
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        replies = session.get(
            f"{prefix}/worker/*/info",
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=0.5,
        )
        workers = [json.loads(reply.ok.payload.to_bytes()) for reply in replies if reply.ok is not None]
        if workers:
            return min(workers, key=lambda worker: worker["load"])
        time.sleep(0.05)
    raise NoAnswer(f"no worker on {prefix}/worker/*/info within {timeout_s} s")


def servo_once(session, prefix, name, changes=None):
    """A task from creation to closing, with one twist in between. `changes` are settings besides those below."""
    worker = least_loaded_worker(session, prefix)
    settings = {
        "camera": {
            "fx": FOCAL_PX,
            "fy": FOCAL_PX,
            "cx": (WIDTH - 1) / 2,
            "cy": (HEIGHT - 1) / 2,
            "width": WIDTH,
            "height": HEIGHT,
        },
        "depth": {"constant_m": DEPTH_M},
        "gain": {"step_fraction": STEP_FRACTION},
        "frame_period_s": FRAME_PERIOD_S,
        # Sideways, downwards and around the optical axis: a shift is then a translation, not partly a tilt.
        "degrees_of_freedom": [True, True, False, False, False, True],
        **(changes or {}),
    }
    created = json.loads(ask(session, f"{prefix}/worker/{worker['worker']}/create/{name}", json.dumps(settings)))
    task, secret = f"{prefix}/task/{created['task']}", bytes.fromhex(created["secret"])

    def control(word):
        return json.loads(ask(session, f"{task}/control", json.dumps({"do": word}), attachment=secret))["status"]

    raw = "application/octet-stream"
    ask(session, f"{task}/target", pixels(picture(0, 0)), frame_header(0, time.time_ns(), secret), encoding=raw)
    started = control("start")
    sequence, asked_at = 7, time.time_ns()
    header = frame_header(sequence, asked_at, secret, deadline_us=2_000_000)
    twist = read_twist(ask(session, f"{task}/twist", pixels(picture(*SHIFT_PX)), header, encoding=raw))
    for name, sent in (("sequence", sequence), ("capture_time_ns", asked_at), ("epoch", created["epoch"])):
        if twist[name] != sent:
            raise ValueError(f"{name}: expected {sent}, got {twist[name]}")
    return {"worker": worker["worker"], "task": created["task"], "started": started, **twist, "closed": control("close")}


def expected_twist():
    """The pattern lies `SHIFT_PX` too far right and down, so the camera has to follow it: right and down, in the part
    `STEP_FRACTION` of the way per frame."""
    metres_per_pixel = DEPTH_M / FOCAL_PX
    speed = [STEP_FRACTION * shift * metres_per_pixel / FRAME_PERIOD_S for shift in SHIFT_PX]
    return [*speed, 0.0, 0.0, 0.0, 0.0]


def agrees(twist, expected):
    return math.dist(twist, expected) <= TOLERANCE * math.hypot(*expected)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--endpoint", required=True, help="a router or worker, like tcp/127.0.0.1:7447")
    parser.add_argument("--prefix", default="domvs")
    parser.add_argument("--name", default="first-client")
    arguments = parser.parse_args()
    with open_session(arguments.endpoint) as session:
        # The lease: when this token goes, the service halts the task.
        lease = session.liveliness().declare_token(f"{arguments.prefix}/client/{arguments.name}/alive")
        result = servo_once(session, arguments.prefix, arguments.name)
        lease.undeclare()
    result["expected"] = expected_twist()
    result["agrees"] = result["status"] == SERVOING and agrees(result["twist"], result["expected"])
    print(json.dumps(result))
    return 0 if result["agrees"] else 1


if __name__ == "__main__":
    sys.exit(main())
