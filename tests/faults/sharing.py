"""How much of another client's flood a client feels: the table of docs/security.md.

    python tests/faults/sharing.py target/release/domvs

Router, worker, alice and bob are processes of their own, over TCP on one machine; the router has the rates and sizes of
deploy/zenoh/tls/router.json5. Alice asks for a twist 30 times a second; bob does nothing, asks as often as the router lets a task
ask, or ten times as often. The cases take turns. Needs tests/python/requirements.txt, and a quiet machine.
"""

import argparse
import json
import pathlib
import socket
import statistics
import subprocess
import sys
import time

import zenoh

import wire

SHIPPED = pathlib.Path(__file__).resolve().parents[2] / "deploy" / "zenoh" / "tls" / "router.json5"
WIDTH, HEIGHT = 320, 240
ALICE_HZ, ALLOWED_HZ = 30.0, 200.0
ROUND_S, ROUNDS = 4.0, 3
CASES = [("alone", 0.0), ("bob asks as often as he may", ALLOWED_HZ), ("bob asks ten times as often", 10 * ALLOWED_HZ)]


def picture(shift):
    """Bumps on a slope, and the same a few pixels aside."""
    rows = range(HEIGHT)
    return bytes((40 + (u + shift) // 4 % 80 + (60 if ((u + shift) // 40 + v // 30) % 2 else 0)) % 256 for v in rows for u in range(WIDTH))


def started(session, client):
    camera = {"fx": 300.0, "fy": 300.0, "cx": (WIDTH - 1) / 2, "cy": (HEIGHT - 1) / 2, "width": WIDTH, "height": HEIGHT}
    task = wire.create(session, client, {"camera": camera, "depth": {"constant_m": 1.0}, "lease": "none"})
    wire.set_target(session, task, picture(0), WIDTH, HEIGHT)
    wire.control(session, task, "start")
    return task


def questions(session, task, hz, seconds, on_reply):
    """Asks at this rate, whatever comes back; returns how often."""
    secret, frame, sent, begin = bytes.fromhex(task["secret"]), picture(3), 0, time.monotonic()
    while (passed := time.monotonic() - begin) < seconds:
        while sent < passed * hz:
            sent += 1
            header, asked = wire.header(WIDTH, HEIGHT, sent, 0, secret, 100_000), time.monotonic()
            session.get(f"{task['task']}/twist", lambda reply, asked=asked: on_reply(reply, asked), payload=frame,
                        attachment=header, encoding=wire.RAW, timeout=1.0)
        time.sleep(0.001)
    time.sleep(1.2)
    return sent


def ask(endpoint, client, hz, seconds):
    """One client's round, as JSON on standard output: milliseconds of the twists that came, and how many were asked for."""
    session, took_ms = wire.open_session(endpoint), []

    def heard(reply, asked):
        if reply.ok is not None and wire.read_twist(reply.ok.payload.to_bytes())["status"] == wire.SERVOING:
            took_ms.append(1000 * (time.monotonic() - asked))

    task = started(session, client)
    sent = questions(session, task, hz, seconds, heard)
    wire.control(session, task, "close")
    session.close()
    print(json.dumps({"sent": sent, "took_ms": took_ms}))


def router():
    """The shipped rates and sizes, on a free port."""
    shipped, config = zenoh.Config.from_file(str(SHIPPED)), zenoh.Config()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    entries = {"mode": '"router"', "listen/endpoints": json.dumps([endpoint]), "scouting/multicast/enabled": "false"}
    entries |= {key: shipped.get_json(key) for key in ("downsampling", "low_pass_filter")}
    for key, value in entries.items():
        config.insert_json5(key, value)
    return zenoh.open(config), endpoint


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("domvs")
    parser.add_argument("--ask", nargs=4, metavar=("ENDPOINT", "CLIENT", "HZ", "SECONDS"), help="be one of the clients")
    arguments = parser.parse_args()
    if arguments.ask:
        endpoint, client, hz, seconds = arguments.ask
        return ask(endpoint, client, float(hz), float(seconds))
    session, endpoint = router()
    worker = subprocess.Popen([arguments.domvs, "serve", "--worker", "w1", "-e", endpoint], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)

    def client(name, hz, seconds):
        command = [sys.executable, __file__, arguments.domvs, "--ask", endpoint, name, str(hz), str(seconds)]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    told = {name: {"alice": [], "sent": 0, "bob": [], "bob sent": 0} for name, _ in CASES}
    try:
        for name, bob_hz in CASES * ROUNDS:
            bob = client("bob", bob_hz, ROUND_S + 2.0) if bob_hz else None
            time.sleep(1.0)
            alice = json.loads(client("alice", ALICE_HZ, ROUND_S).communicate(timeout=60)[0])
            told[name]["alice"] += alice["took_ms"]
            told[name]["sent"] += alice["sent"]
            if bob:
                bob = json.loads(bob.communicate(timeout=60)[0])
                told[name]["bob"] += bob["took_ms"]
                told[name]["bob sent"] += bob["sent"]
    finally:
        worker.terminate()
        worker.wait(5)
        session.close()
    print("| | alice p50 ms | p99 ms | no twist | bob sent, 1/s | bob's twists, 1/s |\n|---|---:|---:|---:|---:|---:|")
    bob_s = ROUNDS * (ROUND_S + 2.0)
    for name, row in told.items():
        took = sorted(row["alice"])
        cells = [f"{statistics.median(took):.2f}", f"{took[int(0.99 * (len(took) - 1))]:.2f}", f"{row['sent'] - len(took)} of {row['sent']}",
                 f"{row['bob sent'] / bob_s:.0f}", f"{len(row['bob']) / bob_s:.0f}"]
        print(f"| {name} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
