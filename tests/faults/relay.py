"""A relay of frames that spoils their order: takes them on one key, puts them on another. Orders on stdin.

{"mode": "plain"}                    as they come
{"mode": "swap"}                     every second frame comes after its successor
{"mode": "twice"}                    each frame twice at once, and a third time 0.4 s later
{"mode": "late", "seconds": s}       each frame so much later, and the fresh one too
{"mode": "shuffle"}                  eight at a time, in any order
"""

import argparse
import heapq
import random
import threading
import time

import child
import wire


class Relay:
    def __init__(self, arguments):
        self.session = wire.open_session(arguments.endpoint)
        self.target = arguments.target
        self.mode, self.seconds = "plain", 1.0
        self.held, self.later = [], []
        self.count = 0
        self.lock = threading.Lock()
        self.dice = random.Random(3)
        self.taker = self.session.declare_subscriber(arguments.source, self.take)
        threading.Thread(target=self.run, daemon=True).start()

    def take(self, sample):
        """Only puts the frame into a queue of what is due when."""
        frame = (sample.payload.to_bytes(), sample.attachment.to_bytes())
        now = time.monotonic()
        with self.lock:
            if self.mode == "swap" and not self.held:
                self.held.append(frame)
                return
            if self.mode == "shuffle":
                self.held.append(frame)
                if len(self.held) < 8:
                    return
                self.dice.shuffle(self.held)
            order = [frame] + self.held if self.mode != "shuffle" else list(self.held)
            self.held.clear()
            for item in order:
                self.due(now, item)
            if self.mode == "twice":
                self.due(now, frame)
                self.due(now + 0.4, frame)
            if self.mode == "late":
                self.due(now + self.seconds, frame)

    def due(self, when, frame):
        self.count += 1
        heapq.heappush(self.later, (when, self.count, frame))

    def run(self):
        while True:
            time.sleep(0.002)
            with self.lock:
                out = []
                while self.later and self.later[0][0] <= time.monotonic():
                    out.append(heapq.heappop(self.later)[2])
            for payload, attachment in out:
                self.session.put(self.target, payload, attachment=attachment, encoding=wire.RAW)

    def obey(self, order):
        with self.lock:
            self.mode = order.get("mode", self.mode)
            self.seconds = order.get("seconds", self.seconds)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--endpoint", required=True)
    parser.add_argument("--source", required=True)
    parser.add_argument("--target", required=True)
    relay = Relay(parser.parse_args())
    child.say(ready=True)
    for order in child.orders():
        relay.obey(order)


if __name__ == "__main__":
    main()
