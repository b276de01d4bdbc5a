"""Checks the files of deploy/ as far as a machine without containers and systemd can.

    python deploy/lint.py

Zenoh configurations: JSON5, and opened by Zenoh itself, router and client on loopback, with every entry in force; those with TLS
under certificates of `domvs certs`. Container file, compose file and unit: their form, and that what they name exists. The commands of `domvs` in them: parsed by
target/release/domvs, if it has been built. README.md: every file it names exists, every file here is named. The last line is
`N passed, N failed`. Needs tests/python/requirements.txt.
"""

import configparser
import json
import pathlib
import re
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import tomllib

import json5
import yaml
import zenoh

DEPLOY = pathlib.Path(__file__).resolve().parent
ROOT = DEPLOY.parent
ROUTER = DEPLOY / "zenoh" / "router.json5"
CLIENT = DEPLOY / "zenoh" / "client.json5"
TLS = DEPLOY / "zenoh" / "tls"
TLS_ROUTER = TLS / "router.json5"
# The members' files, and the name of the member in each.
TLS_MEMBERS = {"service": "service", "client": "alice", "viewer": "viewer", "robot": "robot", "camera": "front"}
UNIT = DEPLOY / "systemd" / "domvs.service"
CONTAINERFILE = DEPLOY / "Containerfile"
COMPOSE = DEPLOY / "compose.yaml"
README = DEPLOY / "README.md"
DOMVS = ROOT / "target" / "release" / "domvs"

# Seconds that a session, a message or a command may take on a loaded machine.
PATIENCE_S = 30
# What the service and both ends of a link rest on; a change here is a change of the design.
IN_BOTH = {
    "scouting/delay": 0,
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/link/tx/lease": 1000,
    "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": 200_000,
    "transport/shared_memory/enabled": False,
}
IN_CLIENT = {"mode": "client", "connect/timeout_ms": -1, "connect/exit_on_failure": False}
IN_TLS_ROUTER = {
    "mode": "router",
    "listen/endpoints": ["tls/0.0.0.0:7447"],
    "transport/link/tls/enable_mtls": True,
    "adminspace/permissions/write": False,
    "access_control/enabled": True,
    "access_control/default_permission": "deny",
}
IN_TLS_CLIENT = IN_CLIENT | {"connect/endpoints": ["tls/127.0.0.1:7447"], "transport/link/tls/enable_mtls": True}
HARDENING = {"NoNewPrivileges": "yes", "DynamicUser": "yes", "ProtectSystem": "strict", "ProtectHome": "yes"}
INSTRUCTIONS = "FROM WORKDIR COPY RUN ENV USER EXPOSE STOPSIGNAL ENTRYPOINT CMD".split()


# Zenoh


def leaves(tree, path=""):
    """(path, value) of every entry of a configuration."""
    if not isinstance(tree, dict):
        yield path, tree
        return
    for key, value in tree.items():
        yield from leaves(value, f"{path}/{key}" if path else key)


def holds(read, written):
    """Whether what Zenoh reads is what is written; in the entries of a list it may add what was left out."""
    if isinstance(written, dict):
        return isinstance(read, dict) and all(holds(read.get(key), value) for key, value in written.items())
    if isinstance(written, list):
        return isinstance(read, list) and len(read) == len(written) and all(map(holds, read, written))
    return read == written


def check_entries(path, expected):
    """Zenoh takes the file, reads every entry as it is written, and these have the value that the design gives them."""
    read = dict(leaves(json.loads(str(zenoh.Config.from_file(str(path))))))
    for entry, written in leaves(json5.loads(path.read_text())):
        assert holds(read.get(entry), written), f"{entry} is {written}, but Zenoh reads {read.get(entry)}"
    for entry, value in expected.items():
        assert read[entry] == value, f"{entry} must be {value}, got {read[entry]}"


def check_size_limit():
    """The largest payload that the service takes gets through Zenoh, with a MiB to spare for key and header."""
    largest = tomllib.loads((DEPLOY / "server.toml").read_text())["limits"]["bytes_per_payload"]
    for path in (ROUTER, CLIENT, *TLS.glob("*.json5")):
        size = json5.loads(path.read_text())["transport"]["link"]["rx"]["max_message_size"]
        assert size >= largest + 2**20, f"{path.name}: max_message_size {size} is too small for payloads of {largest}"


def check_rules():
    """Every rule and subject of the router's access control exists and is used, and none is for everybody."""
    control = json5.loads(TLS_ROUTER.read_text())["access_control"]
    for kind in ("rules", "subjects"):
        ids = [entry["id"] for entry in control[kind]]
        used = {word for policy in control["policies"] for word in policy[kind]}
        assert len(ids) == len(set(ids)) and set(ids) == used, f"{kind}: {sorted(set(ids) ^ used)}"
    for subject in control["subjects"]:
        name = subject["id"].rsplit(" ", 1)[1]
        assert subject["cert_common_names"] == subject["usernames"] == [name], f"one name for certificate and password: {subject}"
    assert not [rule for rule in control["rules"] if rule["permission"] != "allow"], "under default deny, rules only allow"


def check_members():
    """The members' files differ in their names alone."""
    texts = {role: re.sub(r"^//!.*\n", "", (TLS / f"{role}.json5").read_text(), flags=re.MULTILINE) for role in TLS_MEMBERS}
    plain = {text.replace(f'"{name}"', "NAME").replace(f"/{name}.", "/NAME.") for (role, text), name in zip(texts.items(), TLS_MEMBERS.values())}
    assert len(plain) == 1, "they differ in more than names"


def check_lab():
    """With certificates of `domvs certs`, a camera's frame reaches a client over TLS, and nobody else's does."""
    with tempfile.TemporaryDirectory() as folder, socket.socket() as probe:
        lab = pathlib.Path(folder) / "lab"
        made = [DOMVS, "certs", lab, "--client", "alice", "--camera", "front"]
        subprocess.run(made, check=True, capture_output=True, timeout=PATIENCE_S)
        probe.bind(("127.0.0.1", 0))
        endpoints = json.dumps([f"tls/127.0.0.1:{probe.getsockname()[1]}"])
        probe.close()
        router = zenoh.Config.from_file(str(lab / "router.json5"))
        router.insert_json5("listen/endpoints", endpoints)
        members = {name: zenoh.Config.from_file(str(lab / f"{name}.json5")) for name in ("alice", "front")}
        for config in members.values():
            config.insert_json5("connect/endpoints", endpoints)
        heard, came = [], threading.Event()
        with zenoh.open(router), zenoh.open(members["alice"]) as alice, zenoh.open(members["front"]) as front:
            alice.declare_subscriber("domvs/camera/*/*", lambda sample: (heard.append(str(sample.key_expr)), came.set()))
            key = "domvs/camera/front/frame"
            # One after the other: two frames at once are more than the router's rate, whoever they are of.
            keys = ["domvs/camera/other/frame", key] * (5 * PATIENCE_S)
            arrived = any(front.put(each, b"") or came.wait(0.1) for each in keys)
        assert arrived and set(heard) == {key}, f"heard {set(heard)}"


def check_opened():
    """A client that starts first waits for the router, and a message larger than a batch goes from one to the other."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoints = json.dumps([f"tcp/127.0.0.1:{probe.getsockname()[1]}"])
    router, client = (zenoh.Config.from_file(str(path)) for path in (ROUTER, CLIENT))
    router.insert_json5("listen/endpoints", endpoints)
    client.insert_json5("connect/endpoints", endpoints)
    opened, payload, came = [], bytes(300_000), threading.Event()
    opening = threading.Thread(target=lambda: opened.append(zenoh.open(client)), daemon=True)
    opening.start()
    with zenoh.open(router) as session:
        subscriber = session.declare_subscriber("lint", lambda sample: came.set() if len(sample.payload) == len(payload) else None)
        opening.join(PATIENCE_S)
        assert opened, f"the client did not find the router within {PATIENCE_S} s"
        publisher = opened[0].declare_publisher("lint")
        arrived = any(publisher.put(payload) or came.wait(0.1) for _ in range(10 * PATIENCE_S))
        subscriber.undeclare()
        opened[0].close()
    assert arrived, f"no message came through within {PATIENCE_S} s"


# Containers


def instructions():
    """(instruction, its words) of the Containerfile, continued lines joined."""
    text = re.sub(r"\\\n", " ", re.sub(r"^\s*#.*\n", "", CONTAINERFILE.read_text(), flags=re.MULTILINE))
    return [(line.split()[0], line.split()[1:]) for line in text.splitlines() if line.strip()]


def check_containerfile():
    lines = instructions()
    unknown = {word for word, _ in lines} - set(INSTRUCTIONS)
    assert not unknown, f"unknown instructions {sorted(unknown)}"
    images = [words[0] for word, words in lines if word == "FROM"]
    assert len(images) == 2 and lines[0][0] == "FROM", f"expected two stages, got {images}"
    floating = [image for image in images if not re.fullmatch(r"[^:@]+:[\w.-]+", image) or image.endswith(":latest")]
    assert not floating, f"images without a version: {floating}"
    final = lines[max(number for number, (word, _) in enumerate(lines) if word == "FROM") :]
    users = [words[0] for word, words in final if word == "USER"]
    assert len(users) == 1 and re.fullmatch(r"[1-9]\d*:[1-9]\d*", users[0]), f"expected one numeric user, not root, got {users}"
    for needed in ("ENTRYPOINT", "CMD"):
        words = [words for word, words in final if word == needed]
        assert len(words) == 1 and json.loads(" ".join(words[0])), f"expected one {needed} in JSON form, got {words}"


def copied():
    """What the Containerfile copies out of the checkout."""
    for word, words in instructions():
        if word == "COPY" and not words[0].startswith("--from"):
            yield from words[:-1]


def check_copied():
    missing = [source for source in copied() if not (ROOT / source).exists()]
    assert not missing, f"the Containerfile copies {missing}, which do not exist"
    members = json.loads(re.search(r"^members = (\[.*\])$", (ROOT / "Cargo.toml").read_text(), re.MULTILINE)[1])
    assert set(members) <= set(copied()), f"members of the workspace that are not copied: {set(members) - set(copied())}"
    sent = [line[1:] for line in (DEPLOY / "Containerfile.dockerignore").read_text().splitlines() if line.startswith("!")]
    unsent = [source for source in copied() if not any(pathlib.PurePath(source).is_relative_to(path) for path in sent)]
    assert not unsent, f"copied, but kept from the builder by Containerfile.dockerignore: {unsent}"


def check_compose():
    compose = yaml.safe_load(COMPOSE.read_text())
    services = compose["services"]
    assert services.keys() == {"router", "service", "camera"}, f"got {sorted(services)}"
    for name, service in services.items():
        assert {"image", "command", "restart"} <= service.keys(), f"{name} has only {sorted(service)}"
        assert not service["image"].endswith(":latest") and ":" in service["image"], f"{name}: {service['image']} has no version"
        unknown = set(service.get("depends_on", [])) - services.keys()
        assert not unknown, f"{name} depends on {sorted(unknown)}"
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            known = (DEPLOY / source).exists() if source.startswith(".") else source in compose.get("volumes", {})
            assert known, f"{name} mounts {source}, which does not exist"
        if "build" in service:
            context = (DEPLOY / service["build"]["context"]).resolve()
            assert context == ROOT and (context / service["build"]["dockerfile"]).exists(), f"{name}: {service['build']}"
    version = re.search(r'^zenoh = \{ version = "=([\d.]+)"', (ROOT / "Cargo.toml").read_text(), re.MULTILINE)[1]
    assert services["router"]["image"].endswith(f":{version}"), f"the router must be Zenoh {version}"


# systemd


def unit():
    """The unit as sections; the names of systemd keep their case, and a `%` or a `$` is its own business."""
    parser = configparser.ConfigParser(interpolation=None, strict=False, comment_prefixes=("#", ";"))
    parser.optionxform = str
    parser.read_string(UNIT.read_text())
    return parser


def check_unit():
    sections = unit()
    assert sections.sections() == ["Unit", "Service", "Install"], sections.sections()
    service = sections["Service"]
    expected = HARDENING | {"Restart": "on-failure", "KillSignal": "SIGTERM", "StateDirectory": "domvs"}
    wrong = {key: service.get(key) for key, value in expected.items() if service.get(key) != value}
    assert not wrong, f"expected {expected}, got {wrong}"
    assert sections["Unit"].get("After") == "network-online.target", sections["Unit"].get("After")
    assert int(service["LimitNOFILE"]) >= 4096, service["LimitNOFILE"]


def check_unit_by_systemd():
    """`systemd-analyze verify`, with a program in the place of domvs, which is not installed here."""
    with tempfile.TemporaryDirectory() as folder:
        copy = pathlib.Path(folder) / UNIT.name
        copy.write_text(UNIT.read_text().replace("ExecStart=/usr/local/bin/domvs", "ExecStart=/bin/true"))
        command = ["systemd-analyze", "verify", "--man=no", copy]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    said = (done.stdout + done.stderr).strip()
    assert done.returncode == 0 and UNIT.name not in said, said


# What the files say to domvs, and the README


def commands():
    """(where, arguments) of every command of domvs in these files."""
    for name, service in yaml.safe_load(COMPOSE.read_text())["services"].items():
        if "build" in service:
            yield f"compose.yaml {name}", service["command"]
    yield "Containerfile", json.loads(" ".join(next(words for word, words in instructions() if word == "CMD")))
    program, *arguments = shlex.split(unit()["Service"]["ExecStart"])
    assert program == "/usr/local/bin/domvs", program
    yield "domvs.service", [argument for argument in arguments if not argument.startswith("$")]
    for block in re.findall(r"^```sh\n(.*?)^```", README.read_text(), re.MULTILINE | re.DOTALL):
        for line in block.replace("\\\n", " ").splitlines():
            if line.startswith("domvs "):
                yield "README.md", shlex.split(line, comments=True)[1:]


def check_commands():
    """domvs reads every command up to a `--help` at its end: an option or word that it does not have is an error."""
    for where, arguments in commands():
        done = subprocess.run([DOMVS, *arguments, "--help"], capture_output=True, text=True, timeout=PATIENCE_S)
        assert done.returncode == 0, f"{where}: domvs {shlex.join(arguments)}: {done.stderr.strip()}"


def check_readme():
    """README.md names every file of this folder, and no file that does not exist."""
    present = {str(path.relative_to(DEPLOY)) for path in DEPLOY.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    text = README.read_text()
    unnamed = [path for path in sorted(present - {README.name}) if f"`{path}`" not in text]
    assert not unnamed, f"README.md does not name {unnamed}"
    named = re.findall(r"`([\w./-]+\.(?:json5|toml|service|yaml|py))`", text)
    places = (DEPLOY, DEPLOY / "zenoh", ROOT)
    absent = [path for path in named if not any((place / path).exists() for place in places)]
    assert not absent, f"README.md names {absent}, which do not exist"



def checks():
    """(name, check); what cannot be checked on this machine is said instead."""
    yield "router.json5", lambda: check_entries(ROUTER, IN_BOTH | {"mode": "router"})
    yield "client.json5", lambda: check_entries(CLIENT, IN_BOTH | IN_CLIENT)
    yield "tls/router.json5", lambda: check_entries(TLS_ROUTER, IN_BOTH | IN_TLS_ROUTER)
    for role in TLS_MEMBERS:
        yield f"tls/{role}.json5", lambda path=TLS / f"{role}.json5": check_entries(path, IN_BOTH | IN_TLS_CLIENT)
    yield "the rules of tls/router.json5", check_rules
    yield "the members' files of tls", check_members
    yield "the largest message", check_size_limit
    yield "router and client open on loopback", check_opened
    yield "Containerfile", check_containerfile
    yield "what the Containerfile copies", check_copied
    yield "compose.yaml", check_compose
    yield "domvs.service", check_unit
    if shutil.which("systemd-analyze"):
        yield "domvs.service by systemd-analyze", check_unit_by_systemd
    else:
        print("not checked: domvs.service by systemd-analyze, which is not installed")
    if DOMVS.exists():
        yield "the commands of domvs", check_commands
        yield "a lab of domvs certs over TLS", check_lab
    else:
        print("not checked: the commands of domvs, as target/release/domvs is not built")
    yield "README.md", check_readme


def main():
    passed = failed = 0
    for name, check in checks():
        try:
            check()
        except Exception as error:  # one failure must not hide the next
            failed += 1
            print(f"FAILED  {name}: {type(error).__name__}: {error}")
        else:
            passed += 1
            print(f"passed  {name}")
    print(f"{passed} passed, {failed} failed", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
