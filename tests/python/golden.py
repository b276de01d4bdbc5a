"""Reads `proto/golden/v1` with `struct` alone, as docs/protocol.md describes the bytes.

Every `.hex` file is one message; the `.json` file of the same name says what is in it. A file that no check here knows is
a failure, so that a new message cannot go untested.
"""

import json
import math
import struct

FRAME = struct.Struct("<BBBBIIIIfQQII")
FRAME_FIELDS = (
    "version pixel_format depth_format flags width height row_bytes depth_offset depth_unit_m sequence capture_time_ns"
    " deadline_us reserved"
).split()
SECRET_FOLLOWS, SECRET_BYTES = 1, 16

TWIST = struct.Struct("<BBHHHQQIIII6d3dd8x")
TWIST_HEAD = "version status flags order features sequence capture_time_ns epoch queue_us compute_us valid_ms".split()
TWIST_DIAGNOSTICS = "pixel_mse feature_error_norm condition_number gain".split()
TWIST_FLAGS = "speed_limited acceleration_limited within_threshold depth_estimated step_capped".split()

STATUSES = (
    "servoing converged waiting_target waiting_frame stale_frame bad_frame low_texture no_depth diverging iteration_cap"
    " paused stopped owner_lost superseded deadline_missed overloaded frozen_frame internal ready client_lost"
    " rank_deficient lost"
).split()

# The fields that a reader of each JSON message may rely on.
JSON_FIELDS = {
    "camera_info": {"name", "camera", "frame_period_s", "depth"},
    "control": {"do"},
    "control_reply": {"status"},
    "create": {"camera"},
    "create_reply": {"task", "epoch", "secret"},
    "error_reply": {"code", "error"},
    "settings": {"method", "camera", "order", "gain", "watchdog_ms"},
    "status": {"task", "status", "meaning", "epoch", "frames_in", "frames_dropped", "twists", "sequence"},
    "task_closed": {"task", "worker", "epoch", "closed"},
    "task_progress": {"task", "worker", "epoch", "progress"},
    "task_state": {"task", "worker", "epoch", "secret_hash", "settings", "progress"},
    "worker_info": {"worker", "version", "wire_version", "methods", "tasks", "capacity", "load"},
}


def read_frame_header(data):
    """The fields of a header of 48 bytes, or 64 with the secret."""
    fields = dict(zip(FRAME_FIELDS, FRAME.unpack_from(data), strict=True))
    expected = FRAME.size + (SECRET_BYTES if fields["flags"] & SECRET_FOLLOWS else 0)
    assert len(data) == expected, f"a header with flags {fields['flags']} has {expected} bytes, got {len(data)}"
    if fields["flags"] & SECRET_FOLLOWS:
        fields["secret"] = data[FRAME.size :].hex()
    return fields


def read_twist(data):
    """The fields of a twist of 128 bytes in the words of its JSON form: NaN is None, flags are words."""
    fields = TWIST.unpack(data)
    head, twist, diagnostics = fields[:11], fields[11:17], fields[17:]
    message = dict(zip(TWIST_HEAD, head, strict=True))
    message["status"] = STATUSES[message["status"]]
    message["flags"] = [word for bit, word in enumerate(TWIST_FLAGS) if message["flags"] >> bit & 1]
    message["twist"] = list(twist)
    values = (None if math.isnan(value) else value for value in diagnostics)
    message.update(zip(TWIST_DIAGNOSTICS, values, strict=True))
    return message


def compare(got, expected):
    """Field by field, exactly; `depth_unit_m` came through 32 bits, so to half a unit of its last place."""
    assert got.keys() == expected.keys(), f"fields differ: {sorted(got.keys() ^ expected.keys())}"
    for name, value in expected.items():
        same = math.isclose(got[name], value, rel_tol=2**-24) if name == "depth_unit_m" else got[name] == value
        assert same, f"{name}: expected {value}, got {got[name]}"


def check_bytes(path):
    """One `.hex` file against its `.json` twin."""
    read = read_twist if path.name.startswith("twist") else read_frame_header
    compare(read(bytes.fromhex(path.read_text())), json.loads(path.with_suffix(".json").read_text()))


def check_json(path):
    """One JSON message: an object with the fields that readers rely on, and words and secrets in their form."""
    message = json.loads(path.read_text())
    missing = JSON_FIELDS[path.stem] - message.keys()
    assert not missing, f"missing {sorted(missing)}"
    assert message.get("status", STATUSES[0]) in STATUSES, f"unknown status {message['status']}"
    if "secret" in message:
        assert len(bytes.fromhex(message["secret"])) == SECRET_BYTES, message["secret"]


def checks(folder):
    """(name, function) for each message in the folder; without the messages of bytes there is nothing to prove."""
    present = {path.stem for path in folder.glob("*.hex")}
    assert {"frame_header", "twist"} <= present, f"no golden bytes in {folder}, only {sorted(present)}"
    for path in sorted(folder.iterdir()):
        if path.suffix == ".hex":
            yield f"golden {path.name}", lambda path=path: check_bytes(path)
        elif not path.with_suffix(".hex").exists():
            yield f"golden {path.name}", lambda path=path: check_json(path)


def check_documented(protocol):
    """The layouts used here are the ones that docs/protocol.md prints, and it knows every status."""
    for layout in (FRAME.format, TWIST.format):
        assert layout in protocol, f"docs/protocol.md does not print {layout}"
    missing = [word for word in STATUSES if word not in protocol]
    assert not missing, f"docs/protocol.md does not name {missing}"
