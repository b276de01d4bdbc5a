"""Clients that are many, quick, or rude. Says what happened, then waits; ended by kill -9 or by the end of stdin.

`crowd`: --count clients at once, each with a session, a token, a task that is started, and one twist.
`churn`: tasks of one client one after the other, {"from": m, "to": n}: create, target, start, twist, close.
`deaf`:  one client whose channel for answers is never read; {"ask": n} sends n twist requests and n questions for its target.
"""

import argparse
import collections
import json
import threading
import time

import zenoh

import child
import wire
import world

SMALL = 64
LARGE = 1024

# A client may send 500 orders a second (limits.requests_per_s_per_client), and each task takes six.
PACE_S = 0.015


def square(size):
    """The settings of a task for square pictures, and one such picture."""
    camera = {"fx": size, "fy": size, "cx": (size - 1) / 2, "cy": (size - 1) / 2, "width": size, "height": size}
    values = bytes((u * v * 7 // size) % 200 + 20 for v in range(size) for u in range(size))
    return {"camera": camera, "depth": {"constant_m": 1.0}, "order": 6}, values


def visit(session, name, worker, settings, pixels, size):
    """A whole task but its end; returns it and the status of its one twist."""
    task = wire.create(session, name, settings, worker)
    wire.set_target(session, task, pixels, size, size)
    wire.control(session, task, "start")
    attachment = wire.header(size, size, 1, time.time_ns(), bytes.fromhex(task["secret"]))
    told = wire.read_twist(wire.ask(session, f"{task['task']}/twist", pixels, attachment, wire.RAW))
    return task, told["wrong"] or wire.status_word(told["status"])


def crowd(arguments):
    settings, pixels = square(SMALL)
    sessions, outcomes = [], collections.Counter()
    lock = threading.Lock()

    def one(number):
        try:
            name = f"{arguments.name}-{number}"
            session = wire.open_session(arguments.endpoint)
            token = session.liveliness().declare_token(f"domvs/client/{name}/alive")
            task, said = visit(session, name, arguments.worker, settings, pixels, SMALL)
            kept = (session, token, task)
        except (wire.Refused, wire.NoAnswer, zenoh.ZError) as error:
            kept, said = (session,), getattr(error, "code", type(error).__name__)
        with lock:
            sessions.append(kept)
            outcomes[said] += 1

    threads = [threading.Thread(target=one, args=[number]) for number in range(arguments.count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    child.say(ready=True, outcomes=outcomes)
    for _ in child.orders():
        pass
    for kept in sessions:
        kept[0].close()


def churn(arguments):
    settings, pixels = square(SMALL)
    session = wire.open_session(arguments.endpoint)
    token = session.liveliness().declare_token(f"domvs/client/{arguments.name}/alive")
    child.say(ready=True)
    for order in child.orders():
        outcomes = collections.Counter()
        for _ in range(order["from"], order["to"]):
            try:
                task, said = visit(session, arguments.name, arguments.worker, settings, pixels, SMALL)
                wire.control(session, task, "close")
                time.sleep(PACE_S)
            except (wire.Refused, wire.NoAnswer) as error:
                said = getattr(error, "code", type(error).__name__)
            outcomes[said] += 1
        child.say(done=order["to"], outcomes=outcomes)
    token.undeclare()


def deaf(arguments):
    settings, pixels = square(LARGE)
    session = wire.open_session(arguments.endpoint)
    token = session.liveliness().declare_token(f"domvs/client/{arguments.name}/alive")
    task, said = visit(session, arguments.name, arguments.worker, settings, pixels, LARGE)
    secret = bytes.fromhex(task["secret"])
    child.say(ready=True, said=said)
    unread = []
    for order in child.orders():
        for number in range(order["ask"]):
            attachment = wire.header(LARGE, LARGE, number + 2, time.time_ns(), secret)
            channel = zenoh.handlers.FifoChannel(1)
            twist = f"{task['task']}/twist"
            unread.append(session.get(twist, channel, payload=pixels, attachment=attachment, encoding=wire.RAW, timeout=60.0))
            for _ in range(2):
                unread.append(session.get(f"{task['task']}/target", channel, attachment=secret, timeout=60.0))
        child.say(asked=order["ask"])
    token.undeclare()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=["crowd", "churn", "deaf"])
    parser.add_argument("--endpoint", required=True)
    parser.add_argument("--name", default="visitor")
    parser.add_argument("--worker", default="w1")
    parser.add_argument("--count", type=int, default=1)
    arguments = parser.parse_args()
    {"crowd": crowd, "churn": churn, "deaf": deaf}[arguments.kind](arguments)


if __name__ == "__main__":
    main()
