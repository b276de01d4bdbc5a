"""The laboratory: starts router, workers, client and camera as processes, breaks them, and watches from beside the router."""

import json
import os
import pathlib
import signal
import socket
import subprocess
import sys
import threading
import time

import wire

HERE = pathlib.Path(__file__).resolve().parent
READY_S = 20


class Process:
    """One process of the laboratory. Signals go to it alone."""

    def __init__(self, name, command, folder, within=(), speaks=True, **options):
        self.name, self.folder = name, folder
        self.errors = open(folder / f"{name}.err", "ab")
        command = [*within, *map(str, command)]
        out = subprocess.PIPE if speaks else self.errors
        pipe = subprocess.PIPE if speaks else subprocess.DEVNULL
        self.process = subprocess.Popen(command, stdin=pipe, stdout=out, stderr=self.errors, **options)
        self.said = self.first_word() if speaks else {}

    def first_word(self):
        """What it says when it is ready."""
        heard = []
        reader = threading.Thread(target=lambda: heard.append(self.process.stdout.readline()), daemon=True)
        reader.start()
        reader.join(READY_S)
        if not heard or not heard[0]:
            self.kill()
            raise AssertionError(f"{self.name} is not ready within {READY_S} s: {self.last_words()}")
        return json.loads(heard[0])

    def last_words(self):
        return (self.folder / f"{self.name}.err").read_text(errors="replace")[-1500:].strip()

    def order(self, **order):
        self.process.stdin.write((json.dumps(order) + "\n").encode())
        self.process.stdin.flush()

    def signal(self, number):
        self.process.send_signal(number)

    def kill(self):
        """kill -9, and what is left is collected."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()

    def memory_kb(self):
        """Resident memory, and the number of open file descriptors."""
        status = pathlib.Path(f"/proc/{self.process.pid}/status").read_text()
        resident = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))
        return resident, len(os.listdir(f"/proc/{self.process.pid}/fd"))


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Lab:
    """One world: who runs in it, what the judge saw. Use as a context manager; everything ends with it."""

    def __init__(self, domvs, folder, endpoint=None):
        self.domvs, self.folder = domvs, folder
        self.endpoint = endpoint or f"tcp/127.0.0.1:{free_port()}"
        self.processes, self.marks = {}, []
        self.seen, self.lock = [], threading.Condition()
        self.session, self.task = None, None
        folder.mkdir(parents=True, exist_ok=True)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.session is not None:
            self.session.close()
        for process in self.processes.values():
            process.kill()

    def start(self, name, command, **options):
        """Starts a process under a name; one of the same name must be dead."""
        old = self.processes.get(name)
        assert old is None or old.process.poll() is not None, f"{name} still runs"
        self.processes[name] = Process(name, command, self.folder, **options)
        return self.processes[name]

    def __getitem__(self, name):
        return self.processes[name]

    def python(self, script, *arguments):
        return [sys.executable, HERE / script, *arguments]

    # Who is there.

    def router(self, *endpoints, **options):
        return self.start("router", self.python("router.py", *(endpoints or [self.endpoint])), **options)

    def worker(self, name="w1", *arguments, joins=None, within=()):
        """`domvs serve`: its own router, or with `joins` a client of one."""
        command = [self.domvs, "serve", "--worker", name, *arguments]
        command += ["--endpoint", joins] if joins else ["--listen", self.endpoint]
        return self.start(name, command, speaks=False, within=within)

    def owner(self, *arguments, client="lab", endpoint=None, **options):
        """The client process; its task becomes the laboratory's."""
        log = ("--log", self.folder / "requests.jsonl")
        command = self.python("owner.py", "--endpoint", endpoint or self.endpoint, "--client", client, *log, *arguments)
        process = self.start("client", command, **options)
        self.task = process.said
        return process

    def camera(self, *arguments, endpoint=None, **options):
        log = ("--log", self.folder / "camera.jsonl")
        place = ("--endpoint", endpoint or self.endpoint, "--task", self.task["task"])
        place += ("--place", self.folder / "place")
        return self.start("camera", self.python("camera.py", *place, *log, *arguments), **options)

    def arm(self, *arguments, endpoint=None, **options):
        log = ("--log", self.folder / "arm.jsonl", "--place", self.folder / "place")
        place = ("--endpoint", endpoint or self.endpoint, "--task", self.task["task"])
        return self.start("arm", self.python("arm.py", *place, *log, *arguments), **options)

    def proxy(self):
        """A proxy in front of the router; returns the endpoint to use instead of the router's."""
        port = free_port()
        self.start("proxy", self.python("proxy.py", port, self.endpoint.removeprefix("tcp/")))
        return f"tcp/127.0.0.1:{port}"

    # What the judge sees.

    def watch(self, owners=True):
        """Opens the judge's session beside the router; call it when the router is there.

        Without `owners` where memory is measured: Zenoh keeps some bytes for each token it ever told a link of.
        """
        self.session = wire.open_session(self.endpoint)
        keep = self.session.declare_subscriber
        self.watching = [
            keep("domvs/task/*/*/command", self.see_command),
            keep("domvs/task/*/*/status", self.see_status),
        ]
        if owners:
            tokens = self.session.liveliness()
            self.watching.append(tokens.declare_subscriber("domvs/task/*/*/owner/**", self.see_owner, history=True))

    def see_command(self, sample):
        now = time.monotonic()
        self.see({"kind": "command", "t": now, "key": str(sample.key_expr), **wire.read_twist(sample.payload.to_bytes())})

    def see_status(self, sample):
        now = time.monotonic()
        self.see({"kind": "status", "t": now, "key": str(sample.key_expr), **json.loads(sample.payload.to_bytes())})

    def see_owner(self, sample):
        here = str(sample.kind).endswith("PUT")
        self.see({"kind": "owner", "t": time.monotonic(), "key": str(sample.key_expr), "here": here})

    def see(self, record):
        with self.lock:
            self.seen.append(record)
            self.lock.notify_all()

    def mark(self, name):
        """Writes down that something happens now."""
        now = time.monotonic()
        self.marks.append((name, now))
        return now

    def wait_for(self, wanted, since, limit_s, what):
        """The first record seen after `since` for which `wanted` holds."""
        give_up = time.monotonic() + limit_s
        position = 0
        with self.lock:
            while True:
                for record in self.seen[position:]:
                    if record["t"] > since and wanted(record):
                        return record
                position = len(self.seen)
                left = give_up - time.monotonic()
                if left <= 0:
                    raise AssertionError(f"{what}: not within {limit_s} s")
                self.lock.wait(left)

    def wait_for_motion(self, since, limit_s=15.0):
        """The first moving command for a frame that was captured after `since`."""
        offset = time.time() - time.monotonic()

        def moving(record):
            return record["kind"] == "command" and any(record["twist"]) and self.captured(record, offset) > since

        return self.wait_for(moving, since, limit_s, "no motion again")

    def captured(self, record, offset):
        """When its frame was captured, by the camera's clock without its jumps; without a clock, when it was answered."""
        if not record["capture"]:
            return record["t"]
        return record["capture"] / 1e9 - offset - getattr(self, "clock_s", 0.0)

    def steady(self, seconds=1.5):
        """Waits until the camera moves, then for some seconds of servoing."""
        self.wait_for_motion(time.monotonic())
        time.sleep(seconds)

    def kill(self, name):
        """kill -9."""
        self.mark(f"{name} stopped")
        self[name].kill()

    def pause(self, name):
        self.mark(f"{name} stopped")
        self[name].signal(signal.SIGSTOP)

    def resume(self, name):
        self[name].signal(signal.SIGCONT)

    def records(self, name):
        """What a process of this laboratory wrote down."""
        path = self.folder / name
        if not path.exists():
            return []
        lines = path.read_text().splitlines()
        return [json.loads(line) for line in lines if line.endswith("}")]
