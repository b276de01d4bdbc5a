"""Breaks a running Domvs in every way there is a function for, and judges it from outside.

    python tests/faults/run.py target/release/domvs                 # all that needs no root
    python tests/faults/run.py target/release/domvs --quick         # what .ci/run tries, under 3 minutes
    python tests/faults/run.py target/release/domvs --root          # with network namespaces too; needs root
    python tests/faults/run.py target/release/domvs stall camera    # those whose name has all these words

Needs tests/python/requirements.txt. Writes one JSON object for each fault to --json, and with --table the table of
docs/reliability.md from it. The last line is `N passed, N failed, N skipped`.
"""

import argparse
import datetime
import json
import os
import pathlib
import platform
import shutil
import subprocess
import sys
import tempfile
import time
import traceback

import cases
import crowds  # noqa: F401  (registers its faults)
import replicas  # noqa: F401  (likewise)
import table
from lab import Lab

# Set in the environment of a run that is in its own namespaces.
INSIDE = "DOMVS_FAULTS_INSIDE"
ROOT = pathlib.Path(__file__).resolve().parents[2]


def machine():
    """What it ran on, in one line."""
    model = next((line.split(":", 1)[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), platform.machine())
    load = os.getloadavg()[0]
    return f"{os.cpu_count()} cores ({model}), Linux {platform.release()}, load {load:.1f}"


def try_fault(fault, domvs, folder):
    """One fault in a folder of its own; returns its row."""
    row = {"name": fault["name"], "group": fault["group"]}
    begin = time.monotonic()
    try:
        with Lab(domvs, folder) as lab:
            verdict = fault["run"](lab)
            row.update(verdict if isinstance(verdict, dict) else verdict.judge())
    except Exception as error:  # one failure must not hide the next
        traceback.print_exc()
        row["wrong"] = [f"{type(error).__name__}: {error}"]
    row["took_s"] = round(time.monotonic() - begin, 1)
    return row


def say(row):
    word = "FAILED" if row["wrong"] else "passed"
    parts = [f"{name.removesuffix('_ms')} {row[name]} ms" for name in ("zero_ms", "recover_ms", "oldest_ms") if row.get(name) is not None]
    print(f"{word}  {row['name']}: {', '.join(parts)}; {', '.join(row.get('reported', []))} ({row['took_s']} s)", flush=True)
    for wrong in row["wrong"][:5]:
        print(f"        {wrong}", flush=True)


def chosen(arguments):
    """The faults to try, and how many of the rest need root and have none."""
    if arguments.root:
        import disks, namespaces  # noqa: E401, F401  (they register their faults)
    wanted = []
    for fault in cases.FAULTS:
        if arguments.quick and not fault["quick"]:
            continue
        if all(word in f"{fault['group']} {fault['name']}" for word in arguments.words):
            wanted.append(fault)
    return wanted


def enter_namespace():
    """Begins anew in a network and a mount namespace of its own: whatever is made there goes with it."""
    if os.environ.get(INSIDE) is None:
        os.environ[INSIDE] = "1"
        os.execvp("unshare", ["unshare", "--net", "--mount", sys.executable, *sys.argv])
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("domvs", type=pathlib.Path, help="the binary, such as target/release/domvs")
    parser.add_argument("words", nargs="*", help="only faults whose group and name have all these words")
    parser.add_argument("--quick", action="store_true", help="only a few of each group")
    parser.add_argument("--root", action="store_true", help="also those that need root: network namespaces, full disks")
    parser.add_argument("--json", type=pathlib.Path, help="append results here, one object a line")
    parser.add_argument("--table", action="store_true", help="write docs/reliability.md's table from --json")
    parser.add_argument("--keep", action="store_true", help="keep every process's log, and say where")
    arguments = parser.parse_args()
    skipped = 0
    if arguments.root and os.geteuid() != 0:
        print("skipped  network namespaces and full disks: they need root, and this is not root")
        arguments.root, skipped = False, 1
    if arguments.root:
        enter_namespace()
    passed = failed = 0
    folder = pathlib.Path(tempfile.mkdtemp(prefix="domvs-faults-"))
    for number, fault in enumerate(chosen(arguments)):
        row = try_fault(fault, arguments.domvs.resolve(), folder / str(number))
        row["date"], row["machine"] = datetime.date.today().isoformat(), machine()
        say(row)
        passed, failed = passed + (not row["wrong"]), failed + bool(row["wrong"])
        if arguments.json:
            with arguments.json.open("a") as file:
                file.write(json.dumps(row) + "\n")
    if arguments.keep:
        print(f"logs in {folder}")
    else:
        shutil.rmtree(folder)
    if arguments.table:
        table.write(arguments.json, ROOT / "docs" / "reliability.md")
    print(f"{passed} passed, {failed} failed, {skipped} skipped")
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main())
