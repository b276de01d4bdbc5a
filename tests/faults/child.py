"""What every process of the laboratory has: a log of its own on disk, orders on stdin, answers on stdout.

All of them run on one machine, so `time.monotonic` is one clock for all: the truth that no message carries.
"""

import json
import sys
import threading


class Log:
    """One JSON object a line, on disk at once: a process may be killed at any time."""

    def __init__(self, path):
        self.file = open(path, "a", buffering=1)
        self.lock = threading.Lock()

    def __call__(self, record):
        with self.lock:
            self.file.write(json.dumps(record) + "\n")


def say(**record):
    print(json.dumps(record), flush=True)


def orders():
    """The orders that come on stdin, until it ends."""
    for line in sys.stdin:
        yield json.loads(line)
