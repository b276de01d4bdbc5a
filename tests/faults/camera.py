"""A camera: frames of the world as it is from where the arm holds it, and a log of what was truly captured when.

Orders on stdin: {"clock_s": offset of its clock}, {"rate": Hz}, {"silent": true | false}.
"""

import argparse
import threading
import time

import numpy as np
import zenoh

import child
import wire
import world
from arm import Place


class Camera:
    """Renders, sends, and keeps the truth: which capture time was when."""

    def __init__(self, arguments, log):
        self.log = log
        self.place = Place(arguments.place)
        self.rate = arguments.rate
        self.clock_ns = 0
        self.silent = False
        self.blind = arguments.blind
        self.session = wire.open_session(arguments.endpoint, arguments.lease_ms)
        self.alive = self.session.liveliness().declare_token(f"domvs/camera/{arguments.name}/alive")
        key = arguments.key or f"{arguments.task}/frame"
        self.frames = self.session.declare_publisher(
            key, encoding=wire.RAW, congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.DATA
        )
        dice = np.random.default_rng(1)
        self.noise = [dice.normal(0, 1.0, (world.HEIGHT, world.WIDTH)) for _ in range(16)]

    def run(self):
        sequence, due = 0, time.monotonic()
        while True:
            time.sleep(max(0.0, due - time.monotonic()))
            due = max(due + 1 / self.rate, time.monotonic() - 1 / self.rate)
            if not self.silent:
                sequence += 1
                self.send(sequence)

    def send(self, sequence):
        now = time.monotonic()
        capture = 0 if self.blind else time.time_ns() + self.clock_ns
        position = self.place.read()
        pattern = world.swing(now)
        shift = [there - here for there, here in zip(pattern, position)]
        pixels = world.picture(shift, self.noise[sequence % len(self.noise)])
        self.log({"kind": "frame", "t": now, "sequence": sequence, "capture": capture, "off_m": shift})
        self.frames.put(pixels, attachment=wire.header(world.WIDTH, world.HEIGHT, sequence, capture))

    def obey(self, order):
        if "clock_s" in order:
            self.clock_ns = int(order["clock_s"] * 1e9)
            self.log({"kind": "clock", "t": time.monotonic(), "offset_s": order["clock_s"]})
        self.rate = order.get("rate", self.rate)
        self.silent = order.get("silent", self.silent)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--endpoint", required=True)
    parser.add_argument("--task", required=True, help="its key, domvs/task/CLIENT/ID")
    parser.add_argument("--place", required=True, help="the arm's file")
    parser.add_argument("--key", help="publish frames here instead of the task's own key")
    parser.add_argument("--name", default="lab")
    parser.add_argument("--rate", type=float, default=20.0)
    parser.add_argument("--blind", action="store_true", help="frames say no capture time")
    parser.add_argument("--lease-ms", type=int, default=wire.LEASE_MS)
    parser.add_argument("--log", required=True)
    arguments = parser.parse_args()
    camera = Camera(arguments, child.Log(arguments.log))
    threading.Thread(target=camera.run, daemon=True).start()
    child.say(ready=True)
    for order in child.orders():
        camera.obey(order)


if __name__ == "__main__":
    main()
