"""The protocol as docs/protocol.md prints it: two structs, a few keys, JSON. Nothing of the project is imported."""

import json
import math
import struct
import time

import zenoh

FRAME = struct.Struct("<BBBBIIIIfQQII")
TWIST = struct.Struct("<BBHHHQQIIII6d3dd8x")
RAW = "application/octet-stream"
VERSION, MONO8, SECRET_FOLLOWS, SERVOING = 1, 1, 1, 0
STATUSES = (
    "servoing converged waiting_target waiting_frame stale_frame bad_frame low_texture no_depth diverging iteration_cap paused "
    "stopped owner_lost superseded deadline_missed overloaded frozen_frame internal ready client_lost rank_deficient lost"
).split()
# What every end of the laboratory promises, as deploy/zenoh/*.json5 does: a word each second.
LEASE_MS = 1000


class Refused(Exception):
    """An error answer: `code` is its frozen word."""

    def __init__(self, key, code, error):
        super().__init__(f"{key}: {code}: {error}")
        self.code = code


class NoAnswer(Exception):
    """An empty answer, or none within the limit."""


def header(width, height, sequence, capture_ns, secret=None, deadline_us=0):
    """48 bytes, or 64 with the secret."""
    flags = SECRET_FOLLOWS if secret else 0
    fields = (VERSION, MONO8, 0, flags, width, height, 0, 0, 0.0, sequence, capture_ns, deadline_us, 0)
    return FRAME.pack(*fields) + (secret or b"")


def read_twist(payload):
    """The fields of a twist, and under `wrong` what a careful reader brakes for (None: nothing)."""
    if len(payload) != TWIST.size:
        return {"wrong": f"{len(payload)} bytes", "status": None, "twist": [0.0] * 6}
    fields = TWIST.unpack(payload)
    names = ("status", "flags", "order", "features", "sequence", "capture", "epoch", "queue_us", "compute_us", "valid_ms")
    told = dict(zip(names, fields[1:11]))
    told["twist"] = list(fields[11:17])
    told["wrong"] = None
    if fields[0] != VERSION:
        told["wrong"] = f"version {fields[0]}"
    elif not all(map(math.isfinite, told["twist"])):
        told["wrong"] = f"not finite: {told['twist']}"
    elif told["status"] != SERVOING and any(told["twist"]):
        told["wrong"] = f"status {told['status']} with motion {told['twist']}"
    return told


def status_word(code):
    return STATUSES[code] if code is not None and code < len(STATUSES) else f"unknown {code}"


def open_session(endpoint, lease_ms=LEASE_MS, config=None):
    """A client of the router at `endpoint`, which may come later and may come back."""
    made = zenoh.Config.from_file(str(config)) if config else zenoh.Config()
    entries = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": lease_ms,
        "transport/unicast/open_timeout": 2000,
        "transport/shared_memory/enabled": False,
    }
    for key, value in entries.items():
        made.insert_json5(key, json.dumps(value))
    return zenoh.open(made)


def ask_once(session, key, payload=b"", attachment=None, encoding="application/json", timeout_s=0.5):
    """One answer, or `Refused`, or `NoAnswer`."""
    said = "empty"
    for reply in session.get(key, payload=payload, attachment=attachment, encoding=encoding, timeout=timeout_s):
        if reply.ok is not None:
            return reply.ok.payload.to_bytes()
        text = reply.err.payload.to_bytes()
        if text == b"Timeout":
            said = "timeout"
            continue
        error = json.loads(text)
        raise Refused(key, error["code"], error["error"])
    raise NoAnswer(f"{key}: {said}")


def ask(session, key, payload=b"", attachment=None, encoding="application/json", limit_s=5.0):
    """As `ask_once`, again and again while there is silence, until the limit; "unknown_task" for a second only, as the news of a
    task that was just created may still be on its way through the routers."""
    begin = time.monotonic()
    while True:
        try:
            return ask_once(session, key, payload, attachment, encoding, min(1.0, limit_s))
        except (NoAnswer, Refused) as error:
            patience = limit_s if isinstance(error, NoAnswer) else 1.0 if error.code == "unknown_task" else 0.0
            if time.monotonic() > begin + patience:
                raise
            time.sleep(0.02)


def workers(session, timeout_s=0.5):
    """What every worker says about itself."""
    replies = session.get(
        "domvs/worker/*/info",
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=timeout_s,
    )
    return [json.loads(reply.ok.payload.to_bytes()) for reply in replies if reply.ok is not None]


def wait_for_workers(session, count=1, limit_s=15.0):
    give_up = time.monotonic() + limit_s
    while time.monotonic() < give_up:
        found = workers(session)
        if len(found) >= count:
            return sorted(found, key=lambda worker: (worker["load"], worker["tasks"]))
        time.sleep(0.05)
    raise NoAnswer(f"{count} workers within {limit_s} s; {len(found)} there")


def create(session, client, settings, worker=None):
    """The key of a new task and its secret, on the least loaded worker unless one is named."""
    worker = worker or wait_for_workers(session)[0]["worker"]
    made = json.loads(ask(session, f"domvs/worker/{worker}/create/{client}", json.dumps(settings)))
    return {"task": f"domvs/task/{made['task']}", "secret": made["secret"], "epoch": made["epoch"], "worker": worker}


def set_target(session, task, pixels, width, height):
    secret = bytes.fromhex(task["secret"])
    attachment = header(width, height, 0, time.time_ns(), secret)
    return json.loads(ask(session, f"{task['task']}/target", pixels, attachment, RAW))["status"]


def control(session, task, word, limit_s=5.0):
    """The status after `word`."""
    secret = bytes.fromhex(task["secret"])
    return json.loads(ask(session, f"{task['task']}/control", json.dumps({"do": word}), secret, limit_s=limit_s))["status"]


def settings_of(session, task, limit_s=5.0):
    return json.loads(ask(session, f"{task['task']}/settings", b"", bytes.fromhex(task["secret"]), limit_s=limit_s))


def target_of(session, task, limit_s=5.0):
    """The bytes of the target, as they were sent."""
    return ask(session, f"{task['task']}/target", b"", bytes.fromhex(task["secret"]), limit_s=limit_s)
