"""How long a task is without an owner: `domvs serve` processes that are killed or stopped, and a client that calls nothing meanwhile.

    python tests/python/failover.py target/release/domvs [--rounds 10]

A Zenoh router in this process, two or three workers, a camera that pushes 50 pictures a second. In each round the owner gets
SIGKILL (and is started anew) or SIGSTOP (and is let go again), and these are printed, in ms, as median and largest: until the next owner's token
is there, until its first word on `command`, until its first twist. Judged are not the times but what must hold in each round: the next owner is
one generation later, nothing of an older epoch moves after a newer one was heard, the task still has its target.
Needs tests/python/requirements.txt.
"""

import argparse
import json
import pathlib
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time

import zenoh
from first_client import FRAME, MONO8, NO_DEPTH, SECRET_FOLLOWS, SERVOING, TWIST, VERSION, DEPTH_M, FOCAL_PX, HEIGHT, WIDTH, picture, pixels

LEASE_MS = 1000
CAMERA_HZ = 50
LIMIT_S = 20
CLIENT = "failover"


def config(mode, endpoint):
    made = zenoh.Config()
    made.insert_json5("mode", json.dumps(mode))
    made.insert_json5("listen/endpoints" if mode == "router" else "connect/endpoints", json.dumps([endpoint]))
    made.insert_json5("scouting/multicast/enabled", "false")
    made.insert_json5("scouting/gossip/enabled", "false")
    made.insert_json5("transport/link/tx/lease", str(LEASE_MS))
    return made


def wait_until(what, condition):
    """The first true value; too late is a failure."""
    give_up = time.monotonic() + LIMIT_S
    while time.monotonic() < give_up:
        value = condition()
        if value:
            return value
        time.sleep(0.002)
    raise TimeoutError(f"not within {LIMIT_S} s: {what}")


def ask(session, key, payload=b"", attachment=None, encoding="application/json"):
    def answer():
        for reply in session.get(key, payload=payload, attachment=attachment, encoding=encoding, timeout=2.0):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
        return None

    return wait_until(f"an answer on {key}", answer)


def header(sequence, secret=b""):
    flags = SECRET_FOLLOWS if secret else 0
    return FRAME.pack(VERSION, MONO8, NO_DEPTH, flags, WIDTH, HEIGHT, 0, 0, 0.0, sequence, time.time_ns(), 0, 0) + secret


class Workers:
    """Processes by their names."""

    def __init__(self, domvs, endpoint, names, folder):
        self.domvs, self.endpoint, self.folder = domvs, endpoint, folder
        self.processes = {}
        for name in names:
            self.start(name)

    def start(self, name):
        log = (self.folder / f"{name}.log").open("ab")
        command = [self.domvs, "serve", "--worker", name, "-e", self.endpoint]
        self.processes[name] = subprocess.Popen(command, stdout=log, stderr=log)

    def kill(self, name):
        self.processes[name].kill()
        self.processes[name].wait()

    def end(self):
        for process in self.processes.values():
            process.send_signal(signal.SIGCONT)
            process.kill()
            process.wait()


class Heard:
    """The owner's tokens and the words on `command`, each with the time it came."""

    def __init__(self):
        self.owners = {}
        self.words = []
        self.newest = 0
        self.moved_by_older = 0

    def token(self, sample):
        *_, worker, epoch = str(sample.key_expr).split("/")
        if sample.kind == zenoh.SampleKind.PUT:
            self.owners[int(epoch)] = (time.monotonic(), worker)

    def command(self, sample):
        fields = TWIST.unpack(sample.payload.to_bytes())
        status, epoch, twist = fields[1], fields[7], fields[11:17]
        if epoch < self.newest:
            # What an arm drops. It must be nothing that would have moved it for long: the owner is being fenced.
            self.moved_by_older += any(twist)
            return
        self.newest = epoch
        self.words.append((time.monotonic(), epoch, status))


def camera(session, key, stopping):
    shots = [pixels(picture(2.0 + 0.01 * n, 1.0)) for n in range(2)]
    publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
    sequence = 0
    while not stopping.wait(1 / CAMERA_HZ):
        sequence += 1
        publisher.put(shots[sequence % 2], attachment=header(sequence))


def first(heard, epoch, status=None):
    """When the first such word came."""
    return next((at for at, of, said in heard.words if of > epoch and status in (None, said)), None)


def round_of(session, workers, heard, task, names, how):
    """One loss. Returns the three times, in ms."""
    epoch = max(heard.owners)
    owner = heard.owners[epoch][1]
    standby = lambda name: json.loads(ask(session, f"domvs/worker/{name}/info"))["standby"]
    wait_until("every standby knows the task", lambda: all(standby(name) == 1 for name in names if name != owner))
    # Time to make it ready; and a worker that has just joined takes nothing over for its first half second.
    time.sleep(0.8)
    heard.words.clear()
    began = time.monotonic()
    if how == "SIGKILL":
        workers.kill(owner)
    else:
        workers.processes[owner].send_signal(signal.SIGSTOP)
    next_epoch = wait_until("a new owner", lambda: next((of for of in heard.owners if of > epoch), None))
    moving = wait_until("a twist of the new owner", lambda: first(heard, epoch, SERVOING))
    times = (heard.owners[next_epoch][0], first(heard, epoch), moving)
    assert next_epoch >> 16 == (epoch >> 16) + 1, (epoch, next_epoch)
    if how == "SIGKILL":
        workers.start(owner)
    else:
        workers.processes[owner].send_signal(signal.SIGCONT)
        wait_until("the stopped owner is back as a standby", lambda: json.loads(ask(session, f"domvs/worker/{owner}/info"))["tasks"] == 0)
    state = json.loads(ask(session, f"domvs/task/{task}/state"))
    assert state["epoch"] == next_epoch and state["target"] is not None, state
    return [1000 * (at - began) for at in times]


def measure(domvs, count, how, rounds, folder):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    names = [f"w{number}" for number in range(1, count + 1)]
    heard, stopping = Heard(), threading.Event()
    with zenoh.open(config("router", endpoint)), zenoh.open(config("client", endpoint)) as session:
        workers = Workers(domvs, endpoint, names, folder)
        try:
            lease = session.liveliness().declare_token(f"domvs/client/{CLIENT}/alive")
            wait_until("all workers", lambda: len(list(session.liveliness().get("domvs/worker/*/alive"))) == count)
            optics = {"fx": FOCAL_PX, "fy": FOCAL_PX, "cx": (WIDTH - 1) / 2, "cy": (HEIGHT - 1) / 2, "width": WIDTH, "height": HEIGHT}
            # A gain so small that the picture, which nobody moves, is no defect of the camera; a watchdog that a busy machine does not trip.
            settings = {"camera": optics, "depth": {"constant_m": DEPTH_M}, "frames": "pushed", "gain": {"per_s": 0.001}, "watchdog_ms": 500}
            made = json.loads(ask(session, f"domvs/worker/w1/create/{CLIENT}", json.dumps(settings)))
            task, secret = made["task"], bytes.fromhex(made["secret"])
            tokens = session.liveliness().declare_subscriber(f"domvs/task/{task}/owner/**", heard.token, history=True)
            commands = session.declare_subscriber(f"domvs/task/{task}/command", heard.command)
            ask(session, f"domvs/task/{task}/target", pixels(picture(0.0, 0.0)), header(0, secret), "application/octet-stream")
            ask(session, f"domvs/task/{task}/control", json.dumps({"do": "start"}), secret)
            pushing = threading.Thread(target=camera, args=(session, f"domvs/task/{task}/frame", stopping))
            pushing.start()
            wait_until("it moves", lambda: first(heard, 0, SERVOING))
            found = [round_of(session, workers, heard, task, names, how) for _ in range(rounds)]
            stopping.set()
            pushing.join()
            del tokens, commands, lease
        finally:
            stopping.set()
            workers.end()
    for what, times in zip(("next owner's token", "its first word", "its first twist"), zip(*found)):
        print(f"{how} of 1 of {count}: {what}: median {statistics.median(times):.0f} ms, largest {max(times):.0f} ms, n = {rounds}")
    print(f"{how} of 1 of {count}: twists of older epochs that came after a newer one, which arms drop: {heard.moved_by_older}", flush=True)


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("domvs")
    options.add_argument("--rounds", type=int, default=10)
    arguments = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for count in (2, 3):
            for how in ("SIGKILL", "SIGSTOP"):
                measure(arguments.domvs, count, how, arguments.rounds, pathlib.Path(folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
