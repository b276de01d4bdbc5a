"""An arm that obeys docs/protocol.md: it moves by a twist for `valid_ms`, and brakes for everything else.

Its position lies in a file that the camera reads: the only thing the two share. It trusts nobody: another length or
version, a number that is not finite, motion under another status than servoing, an older epoch, a twist for an old
frame, and anything that waited while the arm itself stood still.
"""

import argparse
import mmap
import pathlib
import struct
import threading
import time

import child
import wire

TICK_S = 0.005
# The arm's own pause after which whatever waited is thrown away, and for how long from its waking on: which of its threads wakes first is
# nobody's to say.
PAUSE_S = 0.1
DOUBT_S = 0.2
# How long nothing moves it after frames have become over a second older at once: a clock that was set back, or a backlog.
SETTLING_S = 0.5
# As the service's max_age_ms: a command of which the frame is older than this, against the youngest of the last 10 s.
MAX_AGE_S = 0.2
AGE_WINDOW_S = 10.0


class Place:
    """Where the camera is, metres (x, y): written by the arm, read by the camera, in a file both map."""

    LAYOUT = struct.Struct("<dd")

    def __init__(self, path):
        path = pathlib.Path(path)
        if not path.exists():
            path.write_bytes(bytes(self.LAYOUT.size))
        with path.open("r+b") as file:
            self.map = mmap.mmap(file.fileno(), self.LAYOUT.size)

    def write(self, position):
        self.map[:] = self.LAYOUT.pack(*position)

    def read(self):
        return self.LAYOUT.unpack(self.map[:])


class Arm:
    """Integrates commands; `log` gets one record for each command and each change of motion."""

    def __init__(self, log, place):
        self.log, self.place = log, place
        self.lock = threading.Lock()
        self.position = list(place.read())
        self.velocity = [0.0, 0.0]
        self.until = 0.0
        self.basis = None  # epoch, sequence and capture time of the twist in force
        self.epoch = 0
        self.capture = 0
        self.ages = []
        self.ticked = time.monotonic()
        self.doubtful_until = 0.0
        threading.Thread(target=self.run, daemon=True).start()

    def command(self, sample):
        """A sample of `command`, on Zenoh's thread."""
        now = time.monotonic()
        told = wire.read_twist(sample.payload.to_bytes())
        with self.lock:
            why = self.refusal(told, now)
            moving = why is None and any(told["twist"])
            record = {"kind": "command", "t": now, "obeyed": moving, "why": why}
            for name in ("status", "sequence", "capture", "epoch", "valid_ms", "twist", "flags"):
                record[name] = told.get(name)
            self.log(record)
            if moving:
                self.set_velocity(told["twist"][:2], now, told)
                self.until = now + told["valid_ms"] / 1000
            elif why not in ("older epoch", "older frame"):
                # What is refused for its age says nothing about now; everything else brakes.
                self.set_velocity([0.0, 0.0], now, None)

    def refusal(self, told, now):
        """Why this must not move the arm, or None."""
        if told["wrong"]:
            return told["wrong"]
        if told["epoch"] < self.epoch:
            return "older epoch"
        newer_epoch = told["epoch"] > self.epoch
        self.epoch = told["epoch"]
        if told["status"] != wire.SERVOING or not any(told["twist"]):
            return None
        if now - self.ticked > PAUSE_S:
            self.doubtful_until = now + DOUBT_S
            return "the arm stood still"
        capture, doubt = told["capture"], "not sure of its time yet" if now < self.doubtful_until else None
        if not capture:
            return doubt
        if not newer_epoch and capture <= self.capture and self.capture - capture < 1_000_000_000:
            return "older frame"
        self.capture = capture
        return self.too_old(now, now - capture / 1e9) or doubt

    def too_old(self, now, difference):
        """Against the smallest difference of the last 10 s, as the service judges frames; a jump begins anew, at rest."""
        self.ages = [(seen, old) for seen, old in self.ages if now - seen < AGE_WINDOW_S]
        smallest = min((old for _, old in self.ages), default=difference)
        if abs(difference - smallest) > 1.0:
            self.ages = [(now, difference)]
            if difference > smallest:
                self.doubtful_until = now + SETTLING_S
            return "clock jump"
        self.ages.append((now, difference))
        return "too old" if difference - smallest > MAX_AGE_S else None

    def set_velocity(self, velocity, now, told):
        """Changes what is in force, and says so if it begins or ends motion or changes its basis."""
        self.velocity = velocity
        basis = (told["epoch"], told["sequence"], told["capture"]) if told else None
        if basis != self.basis:
            self.basis = basis
            _, sequence, capture = basis or (None, None, None)
            self.log({"kind": "motion", "t": now, "v": velocity, "sequence": sequence, "capture": capture})

    def run(self):
        """Every 5 ms: the time that has passed moves the arm, and ends what has expired."""
        while True:
            time.sleep(TICK_S)
            now = time.monotonic()
            with self.lock:
                passed, self.ticked = now - self.ticked, now
                if passed > PAUSE_S:
                    self.doubtful_until = now + DOUBT_S
                if any(self.velocity) and (now > self.until or passed > PAUSE_S):
                    self.set_velocity([0.0, 0.0], now, None)
                for axis in range(2):
                    self.position[axis] += self.velocity[axis] * min(passed, PAUSE_S)
                self.place.write(self.position)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--endpoint", required=True)
    parser.add_argument("--task", required=True, help="its key, domvs/task/CLIENT/ID")
    parser.add_argument("--place", required=True, help="the file with its position")
    parser.add_argument("--lease-ms", type=int, default=wire.LEASE_MS)
    parser.add_argument("--log", required=True)
    arguments = parser.parse_args()
    arm = Arm(child.Log(arguments.log), Place(arguments.place))
    session = wire.open_session(arguments.endpoint, arguments.lease_ms)
    follower = session.declare_subscriber(f"{arguments.task}/command", arm.command)
    child.say(ready=True)
    for _ in child.orders():
        pass
    follower.undeclare()
    session.close()


if __name__ == "__main__":
    main()
