"""The verdict on one fault, from what was seen beside the router and from the camera's own truth.

Wrong is, whatever the fault: a twist that moves under another status than servoing, that is not finite or beyond the limits; one for a
frame that was captured longer ago than it may be; an arm that obeyed an older epoch, or that moved on a frame older than
that and `valid_ms`; an arm that moved longer than `valid_ms` without a newer order.
"""

import bisect
import math

import wire

# Settings of the world: max_age_ms, and the watchdog of 3 frames at 20 Hz, which bounds a computation.
MAX_AGE_S = 0.200
WATCHDOG_S = 0.150
# What the judge grants for ways and for its own threads: it stamps in Python, on a machine that does other work too.
SLACK_S = 0.060
LINEAR_M_S, ANGULAR_RAD_S = 0.2, 0.7


class Verdict:
    """One row of the table."""

    def __init__(self, lab, fault, healed, max_age_s=MAX_AGE_S, way_s=0.0):
        """`way_s`: what the fault itself adds to every frame's way, so that no clock on the service's side can see it."""
        self.lab, self.fault, self.healed = lab, fault, healed
        self.limit_s = max_age_s + WATCHDOG_S + SLACK_S + way_s
        self.wrong, self.notes = [], {}
        # Where the same fault comes again and again: when each began, and when it was over.
        self.windows = []
        # The frames' truth is read last, so that it has all that was answered.
        with lab.lock:
            self.commands = [record for record in lab.seen if record["kind"] == "command"]
            self.statuses = [record for record in lab.seen if record["kind"] == "status"]
        self.frames = [record for record in lab.records("camera.jsonl") if record["kind"] == "frame"]
        arm = lab.records("arm.jsonl")
        self.obeyed = [record for record in arm if record["kind"] == "command"]
        self.motions = [record for record in arm if record["kind"] == "motion"]
        # A camera without a clock is known by its sequence.
        for record in (*self.frames, *self.commands, *self.obeyed, *self.motions):
            record["capture"] = record["capture"] or record["sequence"]
        self.truth = {frame["capture"]: frame["t"] for frame in self.frames}

    def judge(self):
        """All checks; returns the row."""
        self.check_commands()
        self.check_arm()
        recovered = self.recovered()
        return {
            "wrong": self.wrong,
            "commands": len(self.commands),
            "moving": sum(any(command["twist"]) for command in self.commands),
            "oldest_ms": self.oldest_ms(),
            "zero_ms": self.zero_ms(recovered),
            "recover_ms": None if recovered is None else round(1000 * (recovered - self.healed)),
            "reported": self.reported(recovered),
            "refused_by_arm": self.refused_by_arm(),
            **self.lost(recovered),
            **self.notes,
        }

    def note(self, **facts):
        self.notes.update(facts)
        return self

    def expect(self, holds, what):
        """A condition of one fault only."""
        if not holds:
            self.wrong.append(what)
        return self

    def age(self, command):
        """Seconds from the capture of its frame to when the judge saw it, or None for a frame that nobody sent."""
        captured = self.truth.get(command["capture"])
        return None if captured is None else command["t"] - captured

    def check_commands(self):
        for command in self.commands:
            if command["wrong"]:
                self.wrong.append(f"a command is wrong: {command['wrong']}")
                continue
            twist = command["twist"]
            if not any(twist):
                continue
            linear, angular = math.hypot(*twist[:3]), math.hypot(*twist[3:])
            if linear > LINEAR_M_S * 1.000001 or angular > ANGULAR_RAD_S * 1.000001:
                self.wrong.append(f"beyond the limits: {twist}")
            age = self.age(command)
            if age is None:
                self.wrong.append(f"a moving command for a frame that was never captured: {command['capture']}")
            elif age > self.limit_s:
                self.wrong.append(f"a moving command for a frame of {1000 * age:.0f} ms, epoch {command['epoch']}")

    def check_arm(self):
        """What the arm did, whoever told it: no older epoch, nothing older than the frame's age and valid_ms."""
        epoch = 0
        for command in self.obeyed:
            if command["obeyed"] and command["epoch"] < epoch:
                self.wrong.append(f"the arm obeyed epoch {command['epoch']} after {epoch}")
            epoch = max(epoch, command["epoch"] or 0)
        valid_s = max((command["valid_ms"] or 0 for command in self.obeyed), default=0) / 1000
        ends = [motion["t"] for motion in self.motions[1:]] + [None]
        for motion, end in zip(self.motions, ends):
            if not any(motion["v"]) or end is None:
                continue
            captured = self.truth.get(motion["capture"])
            # An arm that was itself stopped by a signal cannot brake; whatever it then moves is its own drive's business.
            end = min(end, self.stood_still(motion["t"], end))
            if captured is not None and end - captured > self.limit_s + valid_s + SLACK_S:
                self.wrong.append(f"the arm moved on a frame of {1000 * (end - captured):.0f} ms")
            if end - motion["t"] > valid_s + SLACK_S:
                self.wrong.append(f"the arm moved {1000 * (end - motion['t']):.0f} ms on one order of {1000 * valid_s:.0f} ms")

    def stood_still(self, begin, end):
        """When the arm's own process was stopped between these, or the end."""
        stopped = [when for name, when in self.lab.marks if name == "arm stopped" and begin <= when <= end]
        return min(stopped, default=end)

    def oldest_ms(self):
        """The oldest frame that a moving command was for, when the judge saw it."""
        ages = [self.age(command) or 0.0 for command in self.commands if any(command["twist"])]
        return round(1000 * max(ages, default=0.0))

    def recovered(self):
        """When the arm first moved by a frame captured after the healing."""
        for command in self.obeyed:
            if command["obeyed"] and self.truth.get(command["capture"], 0.0) > self.healed:
                return command["t"]
        return None

    def zero_ms(self, recovered):
        """From the fault to the arm at rest; None if it never came to rest before it had recovered."""
        for motion in self.motions:
            if motion["t"] >= self.fault and (recovered is None or motion["t"] <= recovered) and not any(motion["v"]):
                own = any(name == "arm stopped" and when <= motion["t"] for name, when in self.lab.marks)
                return None if own else round(1000 * (motion["t"] - self.fault))
        return None

    def reported(self, recovered):
        """The words on `command` and `status` from the fault until it servos again, in their order, each once."""
        until = (recovered or math.inf) + 0.1
        words = {}
        for command in self.commands:
            if self.fault <= command["t"] <= until:
                words.setdefault(wire.status_word(command["status"]), command["t"])
        for status in self.statuses:
            if self.fault <= status["t"] <= until:
                words.setdefault(status["status"], status["t"])
        return [word for word, _ in sorted(words.items(), key=lambda item: item[1]) if word != "servoing"]

    def refused_by_arm(self):
        """How often the arm refused a command, by reason."""
        counts = {}
        for command in self.obeyed:
            if command["why"]:
                counts[command["why"]] = counts.get(command["why"], 0) + 1
        return counts

    def lost(self, recovered):
        """Frames sent, and those without any answer: in the fault's time, and outside of it."""
        answered = {command["capture"] for command in self.commands}
        windows = self.windows or [(self.fault, recovered or math.inf)]
        first = min((command["t"] for command in self.commands if any(command["twist"])), default=math.inf)
        last = self.frames[-1]["t"] - 0.3 if self.frames else 0.0
        unanswered = [frame["t"] for frame in self.frames if frame["capture"] not in answered and first < frame["t"] < last]
        during = [when for when in unanswered if any(begin - 0.3 <= when <= end + 0.3 for begin, end in windows)]
        outside = len(unanswered) - len(during)
        total = bisect.bisect(sorted(frame["t"] for frame in self.frames), last)
        if outside > max(2, 0.05 * total):
            self.wrong.append(f"{outside} of {total} frames without an answer outside of the fault's time")
        return {"frames": len(self.frames), "unanswered_during": len(during), "unanswered_else": outside}
