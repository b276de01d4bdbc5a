"""A client: its lease, its task, and, if wanted, a loop of twist requests. Says the task and its secret once it servos.

With --again TASK SECRET it comes back to a task it already has: declares its token and starts it.
Orders on stdin: {"requests_hz": rate, 0 to end}.
"""

import argparse
import json
import threading
import time

import numpy as np

import child
import wire
import world


class Requests:
    """Asks for a twist at a rate, and logs what comes for each: a status, a code, silence."""

    def __init__(self, session, task, log):
        self.session, self.task, self.log = session, task, log
        self.rate = 0.0
        self.sequence = 0
        self.noise = np.random.default_rng(2).normal(0, 1.0, (world.HEIGHT, world.WIDTH))
        threading.Thread(target=self.run, daemon=True).start()

    def run(self):
        while True:
            if not self.rate:
                time.sleep(0.02)
                continue
            begin = time.monotonic()
            self.one(begin)
            time.sleep(max(0.0, begin + 1 / self.rate - time.monotonic()))

    def one(self, begin):
        self.sequence += 1
        secret = bytes.fromhex(self.task["secret"])
        attachment = wire.header(world.WIDTH, world.HEIGHT, self.sequence, time.time_ns(), secret, 200_000)
        record = {"kind": "request", "t": begin, "sequence": self.sequence}
        try:
            pixels = world.picture(world.swing(begin), self.noise)
            told = wire.read_twist(wire.ask_once(self.session, f"{self.task['task']}/twist", pixels, attachment, wire.RAW, 0.25))
            record["epoch"] = told.get("epoch")
            record["said"] = told["wrong"] or wire.status_word(told["status"])
            record["right"] = told["wrong"] is None and told["sequence"] == self.sequence
        except wire.Refused as refused:
            record["said"] = f"error {refused.code}"
        except wire.NoAnswer as silence:
            record["said"] = str(silence).rsplit(": ", 1)[-1]
        record["took_ms"] = round(1000 * (time.monotonic() - begin), 2)
        self.log(record)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--endpoint", required=True)
    parser.add_argument("--client", required=True)
    parser.add_argument("--settings", default="{}", help="JSON, besides those of the world")
    parser.add_argument("--worker", help="create the task there")
    parser.add_argument("--again", nargs=2, metavar=("TASK", "SECRET"))
    parser.add_argument("--lease-ms", type=int, default=wire.LEASE_MS)
    parser.add_argument("--log", required=True)
    arguments = parser.parse_args()
    session = wire.open_session(arguments.endpoint, arguments.lease_ms)
    token = session.liveliness().declare_token(f"domvs/client/{arguments.client}/alive")
    if arguments.again:
        task = dict(zip(("task", "secret"), arguments.again))
    else:
        settings = world.settings(**json.loads(arguments.settings))
        task = wire.create(session, arguments.client, settings, arguments.worker)
        wire.set_target(session, task, world.picture((0.0, 0.0)), world.WIDTH, world.HEIGHT)
    give_up = time.monotonic() + 5
    while (status := wire.control(session, task, "start")) == "client_lost" and time.monotonic() < give_up:
        time.sleep(0.01)
    requests = Requests(session, task, child.Log(arguments.log))
    child.say(ready=True, status=status, **task)
    for order in child.orders():
        requests.rate = order.get("requests_hz", requests.rate)
    token.undeclare()
    session.close()


if __name__ == "__main__":
    main()
