"""The running service as a stranger sees it: Python, `struct`, `eclipse-zenoh` and docs/protocol.md.

    python tests/python/run.py target/release/domvs

Starts `domvs serve` as its own router on a free loopback port, from deploy/zenoh/router.json5, with a recording. Then:
the golden bytes; a twist by request, and a photometric one against numpy's; twists by pushed frames, and zeros when they
stop; the example of docs/protocol.md as it is printed; the end by SIGTERM; the recording, read by the `mcap` package. The last
line is `N passed, N failed`.
Needs tests/python/requirements.txt. Ends within LIMIT_S, whatever happens.
"""

import argparse
import json
import os
import pathlib
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import traceback

import first_client
import golden
import photometric

ROOT = pathlib.Path(__file__).resolve().parents[2]
PROTOCOL = ROOT / "docs" / "protocol.md"
# Seconds. The sum of all the limits below is less than the first, which is the last resort.
LIMIT_S = 240
READY_S = 20
CLIENT_S = 30
PUSHED_S = 15
STOP_S = 2
READ_S = 30


class Report:
    """Counts, and says each result as it comes."""

    def __init__(self):
        self.passed = self.failed = 0

    def run(self, name, check):
        """Runs one check; what it raises is its failure. Returns whether it passed."""
        try:
            check()
        except Exception as error:  # one failure must not hide the next
            self.failed += 1
            print(f"FAILED  {name}: {error or type(error).__name__}", flush=True)
            traceback.print_exc()
            return False
        self.passed += 1
        print(f"passed  {name}", flush=True)
        return True

    def finish(self):
        """The last line, and the exit code."""
        print(f"{self.passed} passed, {self.failed} failed", flush=True)
        return 1 if self.failed or not self.passed else 0


class Service:
    """One `domvs serve` process on a port of its own."""

    def __init__(self, domvs, folder):
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.recordings = folder / "recordings"
        self.log = folder / "serve.log"
        config = folder / "router.json5"
        config.write_text(router_config(self.endpoint))
        command = [domvs, "serve", "--zenoh-config", config, "--record", self.recordings]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def wait_until_ready(self):
        """Until a worker answers `domvs/worker/*/info`; a process that ends before is a failure at once."""
        deadline = time.monotonic() + READY_S
        while time.monotonic() < deadline:
            assert self.process.poll() is None, f"the service ended with {self.process.returncode}: {self.said()}"
            if listens(self.endpoint):
                with first_client.open_session(self.endpoint) as session:
                    info = first_client.least_loaded_worker(session, "domvs", deadline - time.monotonic())
                assert info["wire_version"] == 1, info
                return
            time.sleep(0.02)
        raise AssertionError(f"not ready within {READY_S} s: {self.said()}")

    def stop(self):
        """SIGTERM, then exit code 0 within STOP_S."""
        begin = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        try:
            code = self.process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"still there {STOP_S} s after SIGTERM: {self.said()}") from None
        assert code == 0, f"expected exit code 0 after SIGTERM, got {code}: {self.said()}"
        print(f"        ended {time.monotonic() - begin:.2f} s after SIGTERM")

    def kill(self):
        """The end, if it is still there."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()

    def said(self):
        """The end of what the service printed."""
        return self.log.read_text(errors="replace")[-2000:].strip() or "(it printed nothing)"


def free_port():
    """A TCP port that the system has just found free."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def listens(endpoint):
    """Whether somebody accepts connections there."""
    host, port = endpoint.removeprefix("tcp/").split(":")
    try:
        socket.create_connection((host, int(port)), timeout=1).close()
    except OSError:
        return False
    return True


def router_config(endpoint):
    """deploy/zenoh/router.json5, listening on `endpoint`; everything else as it is shipped."""
    shipped = (ROOT / "deploy" / "zenoh" / "router.json5").read_text()
    changed, count = re.subn(r"endpoints: \[[^]]*\]", f'endpoints: ["{endpoint}"]', shipped)
    assert count == 1, f"expected one list of endpoints in router.json5, got {count}"
    return changed


def run_python(arguments, limit_s):
    """Standard output of a Python program that must end with 0 within the limit."""
    done = subprocess.run([sys.executable, *arguments], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=limit_s)
    assert done.returncode == 0, f"exit code {done.returncode}\n{done.stdout[-1500:]}{done.stderr[-1500:]}"
    return done.stdout


def check_first_client(endpoint):
    """A twist by request: the client judges it against the shift it made the picture with; so does this."""
    out = run_python([ROOT / "tests" / "python" / "first_client.py", "--endpoint", endpoint], CLIENT_S)
    result = json.loads(out.splitlines()[-1])
    assert result["agrees"] and result["status"] == first_client.SERVOING, result
    assert first_client.agrees(result["twist"], first_client.expected_twist()), result


def check_pushed_frames(endpoint):
    """Frames published on `frame` bring a moving twist on `command`; when they stop, exact zeros follow."""
    with first_client.open_session(endpoint) as session:
        worker = first_client.least_loaded_worker(session, "domvs")["worker"]
        width, height = first_client.WIDTH, first_client.HEIGHT
        camera = {"fx": 300.0, "fy": 300.0, "cx": (width - 1) / 2, "cy": (height - 1) / 2, "width": width, "height": height}
        settings = {"camera": camera, "depth": {"constant_m": 1.0}, "lease": "none", "autostart": True}
        created = first_client.ask(session, f"domvs/worker/{worker}/create/pusher", json.dumps(settings))
        created = json.loads(created)
        task, secret = f"domvs/task/{created['task']}", bytes.fromhex(created["secret"])
        target = first_client.pixels(first_client.picture(0, 0))
        header = first_client.frame_header(0, time.time_ns(), secret)
        first_client.ask(session, f"{task}/target", target, header, encoding="application/octet-stream")

        twists, came = [], threading.Condition()

        def take(sample):
            with came:
                twists.append(first_client.read_twist(sample.payload.to_bytes()))
                came.notify()

        with session.declare_subscriber(f"{task}/command", take):
            push_until_moving(session, task, secret, twists, came)
            with came:
                stopped = came.wait_for(lambda: not any(twists[-1]["twist"]), PUSHED_S)
            assert stopped, f"no zeros after the last frame: {twists[-1]}"
        first_client.ask(session, f"{task}/control", json.dumps({"do": "close"}), attachment=secret)


def push_until_moving(session, task, secret, twists, came):
    """Publishes frames of a shifted picture, each another one, until a command moves the camera."""
    deadline, sequence = time.monotonic() + PUSHED_S, 0
    while time.monotonic() < deadline:
        sequence += 1
        header = first_client.frame_header(sequence, time.time_ns(), secret)
        pixels = first_client.pixels(first_client.picture(3.0 + 0.1 * (sequence % 7), 2.0))
        session.put(f"{task}/frame", pixels, attachment=header, encoding="application/octet-stream")
        with came:
            if came.wait_for(lambda: twists and any(twists[-1]["twist"]), 0.1):
                moving = twists[-1]
                assert moving["status"] == first_client.SERVOING and moving["valid_ms"] > 0, moving
                assert moving["twist"][0] > 0, f"the picture lies right, so the camera moves right: {moving}"
                return
    raise AssertionError(f"no moving twist on command within {PUSHED_S} s; the last was {twists[-1:]}")


def check_documented_example(endpoint, folder):
    """The example of docs/protocol.md as it is printed; only the router's address is put in."""
    blocks = re.findall(r"^```python\n(.*?)^```", PROTOCOL.read_text(), re.MULTILINE | re.DOTALL)
    examples = [block for block in blocks if "zenoh.open" in block]
    assert examples, f"no ```python block of docs/protocol.md opens a session, among {len(blocks)}"
    for number, example in enumerate(examples):
        program, count = re.subn(r"tcp/[\w.]+:7447", endpoint, example)
        assert count, "the example names no endpoint such as tcp/127.0.0.1:7447"
        path = folder / f"example_{number}.py"
        path.write_text(program)
        print("        " + run_python([path], CLIENT_S).strip().replace("\n", "\n        "))


def check_recording(recordings):
    """One finished MCAP file with a target, frames, twists, statuses and settings in it."""
    files = sorted(recordings.glob("*.mcap"))
    assert len(files) == 1, f"expected one recording, got {[file.name for file in files]}"
    reader = ROOT / "server" / "tests" / "python" / "read_mcap.py"
    found = json.loads(run_python([reader, files[0]], READ_S))
    assert found["complete"], "the recording has no end, although the service was stopped in order"
    leaves = {topic.rsplit("/", 1)[-1]: count for topic, count in found["topics"].items()}
    missing = {"target", "frame", "twist", "command", "status", "settings"} - leaves.keys()
    assert not missing, f"no messages of {sorted(missing)}, only of {leaves}"


def run_golden(report):
    """The golden bytes and the words of docs/protocol.md; no service needed."""
    for name, check in golden.checks(ROOT / "proto" / "golden" / "v1"):
        report.run(name, check)
    report.run("docs/protocol.md prints the layouts", lambda: golden.check_documented(PROTOCOL.read_text()))


def run_service(domvs, folder, report):
    """The checks of one running service, in an order in which each leaves something for the next."""
    service = Service(domvs, folder)
    last_resort = threading.Timer(LIMIT_S, give_up, [service, report])
    last_resort.daemon = True
    last_resort.start()
    try:
        if report.run("the service gets ready", service.wait_until_ready):
            report.run("a twist by request", lambda: check_first_client(service.endpoint))
            report.run("a photometric twist", lambda: photometric.check(service.endpoint))
            report.run("twists by pushed frames", lambda: check_pushed_frames(service.endpoint))
            report.run("the example of docs/protocol.md", lambda: check_documented_example(service.endpoint, folder))
            report.run("the service ends by SIGTERM", service.stop)
            report.run("the recording", lambda: check_recording(service.recordings))
    finally:
        service.kill()
        last_resort.cancel()
    if report.failed:
        print(f"The service said:\n{service.said()}")


def give_up(service, report):
    """The last resort: something hung in spite of its own limit."""
    service.process.kill()
    report.failed += 1
    print(f"FAILED  nothing may take longer than {LIMIT_S} s")
    code = report.finish()
    os._exit(code)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("domvs", type=pathlib.Path, help="the binary, such as target/release/domvs")
    domvs = parser.parse_args().domvs.resolve()
    report = Report()
    run_golden(report)
    with tempfile.TemporaryDirectory(prefix="domvs-python-") as folder:
        if report.run("the binary exists", lambda: domvs.stat()):
            run_service(domvs, pathlib.Path(folder), report)
    return report.finish()


if __name__ == "__main__":
    sys.exit(main())
