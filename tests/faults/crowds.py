"""Many clients, many tasks, fast cameras, deaf clients: what a bystander's task feels of them, and what they leave behind."""

import json
import time

import wire
from cases import alone, fault, people
from judge import Verdict

# A worker for crowds: room for all, and halted tasks are closed after a second.
CONFIG = "[limits]\ntasks = 256\ntasks_per_client = 16\n[lease]\ngrace_s = 1\n"
VISITORS, AT_ONCE, A_PROCESS = 1000, 100, 25
# What memory may grow by between the first tenth and the end, KiB, and file descriptors.
GROWTH_KB, GROWTH_FDS = 24 * 1024, 4
# What Zenoh 1.10.2 keeps, KiB, for the keys of one task, on each end of a link until the link ends: docs/reliability.md.
KEYS_KB = 16.0


def crowded(lab, **options):
    config = lab.folder / "server.toml"
    config.write_text(CONFIG)
    alone(lab, "--config", config, owners=False, **options)


def latency(verdict, begin, end):
    """Milliseconds from a frame's capture to its command at the judge, the median and the 99th percentile."""
    took = sorted(verdict.age(command) or 0 for command in verdict.commands if begin <= command["t"] < end and command["capture"] in verdict.truth)
    if not took:
        return None
    return [round(1000 * took[int(share * (len(took) - 1))], 1) for share in (0.5, 0.99)]


def gap_ms(verdict, begin, end):
    """The longest time without a command for the bystander."""
    times = [command["t"] for command in verdict.commands if begin <= command["t"] < end and command["key"].startswith(verdict.lab.task["task"])]
    return round(1000 * max((later - sooner for sooner, later in zip(times, times[1:])), default=0.0))


def of_bystander(lab, verdict):
    """Only the laboratory's own task is judged against the camera's truth."""
    verdict.commands = [command for command in verdict.commands if command["key"].startswith(lab.task["task"])]
    verdict.statuses = [status for status in verdict.statuses if status["key"].startswith(lab.task["task"])]
    return verdict


def wait_for_tasks(lab, count, limit_s=15.0):
    """Until the worker says that it has so many tasks; what it says then."""
    give_up = time.monotonic() + limit_s
    while time.monotonic() < give_up:
        found = wire.workers(lab.session)
        if found and found[0]["tasks"] == count:
            return count
        time.sleep(0.1)
    return found[0]["tasks"] if found else None


def visitors(lab, name, kind, count=1):
    command = lab.python("visitors.py", kind, "--endpoint", lab.endpoint, "--name", name, "--count", count)
    return lab.start(name, command)


@fault("crowds")
def thousand_clients(lab):
    """1000 clients, 100 at a time; half of them vanish by kill -9, half close"""
    crowded(lab)
    quiet_s = time.monotonic()
    time.sleep(5.0)
    begin = lab.mark("fault")
    outcomes, sizes = {}, []
    for batch in range(VISITORS // AT_ONCE):
        group = [visitors(lab, f"v{batch}x{number}", "crowd", A_PROCESS) for number in range(AT_ONCE // A_PROCESS)]
        for process in group:
            for word, count in process.said["outcomes"].items():
                outcomes[word] = outcomes.get(word, 0) + count
        for process in group:
            if batch % 2:
                process.process.stdin.close()
                process.process.wait()
            else:
                process.kill()
        wait_for_tasks(lab, 1)
        sizes.append(lab["w1"].memory_kb())
    end = lab.mark("healed")
    left = wait_for_tasks(lab, 1)
    time.sleep(1.0)
    verdict = of_bystander(lab, Verdict(lab, begin, end))
    verdict.note(clients=outcomes, latency_before_ms=latency(verdict, quiet_s, begin), latency_during_ms=latency(verdict, begin, end))
    verdict.note(longest_gap_ms=gap_ms(verdict, begin, end), tasks_left=left, memory_kb_and_fds=[sizes[1], sizes[-1]])
    verdict.expect(left == 1, f"{left} tasks are left, 1 is the bystander's")
    return flat(verdict, sizes[1:])


def flat(verdict, sizes, allowed_kb=0.0):
    """Memory and file descriptors of the end against those after the first part."""
    (memory, files), (memory_end, files_end) = sizes[0], sizes[-1]
    verdict.expect(memory_end - memory < GROWTH_KB + allowed_kb, f"memory grew from {memory} to {memory_end} KiB")
    return verdict.expect(files_end - files <= GROWTH_FDS, f"file descriptors grew from {files} to {files_end}")


@fault("crowds")
def task_churn(lab):
    """10 000 tasks of one client, made, used once and closed"""
    crowded(lab)
    return churned(lab, (1000, 2000, 5000, 10000))


@fault("crowds")
def task_churn_behind_router(lab):
    """3000 tasks of one client, made, used once and closed, on a worker that joined a router"""
    lab.router()
    lab.worker("w1", joins=lab.endpoint)
    people(lab, owners=False)
    return churned(lab, (1000, 2000, 3000), per_task_kb=KEYS_KB)


@fault("crowds", quick=True)
def short_churn(lab):
    """600 tasks of one client, made, used once and closed"""
    crowded(lab)
    return churned(lab, (200, 600))


def churned(lab, steps, per_task_kb=0.0):
    """`per_task_kb`: what a task may leave behind."""
    begin = lab.mark("fault")
    process = visitors(lab, "churn", "churn")
    sizes, outcomes, reached = [], {}, 0
    for step in steps:
        process.order(**{"from": reached, "to": step})
        said = json.loads(process.process.stdout.readline())
        reached = step
        for word, count in said["outcomes"].items():
            outcomes[word] = outcomes.get(word, 0) + count
        sizes.append(lab["w1"].memory_kb())
        print(f"        {step}: {sizes[-1][0]} KiB, {sizes[-1][1]} file descriptors", flush=True)
    end = lab.mark("healed")
    time.sleep(1.0)
    verdict = of_bystander(lab, Verdict(lab, begin, end))
    verdict.note(tasks=outcomes, seconds=round(end - begin, 1), steps=steps, memory_kb_and_fds=sizes)
    verdict.note(latency_during_ms=latency(verdict, begin, end), tasks_left=wait_for_tasks(lab, 1))
    verdict.expect(set(outcomes) == {"servoing"}, f"not every task had its twist: {outcomes}")
    verdict.expect(verdict.notes["tasks_left"] == 1, f"{verdict.notes['tasks_left']} tasks are left")
    return flat(verdict, sizes, per_task_kb * (steps[-1] - steps[0]))


@fault("crowds", quick=True)
def fast_camera(lab):
    """a camera at 500 Hz for 10 s, in place of one at 20 Hz"""
    alone(lab)
    first = lab["w1"].memory_kb()
    begin = lab.mark("fault")
    lab["camera"].order(rate=500)
    time.sleep(5.0)
    middle = lab["w1"].memory_kb()
    time.sleep(5.0)
    sizes = [middle, lab["w1"].memory_kb()]
    lab["camera"].order(rate=20)
    end = lab.mark("healed")
    lab.wait_for_motion(end)
    time.sleep(1.0)
    verdict = Verdict(lab, begin, end)
    sent = sum(begin <= frame["t"] < end for frame in verdict.frames)
    answered = sum(begin <= command["t"] < end for command in verdict.commands)
    dropped = verdict.statuses[-1]["frames_dropped"]
    verdict.note(frames_hz=round(sent / (end - begin)), commands_hz=round(answered / (end - begin)), dropped=dropped)
    verdict.note(latency_during_ms=latency(verdict, begin, end), memory_kb_and_fds=[first, *sizes])
    return flat(verdict, sizes)


@fault("crowds", quick=True)
def deaf_client(lab):
    """4 clients that each send 100 frames and 200 questions for their 1 MB target, and never read an answer"""
    crowded(lab)
    quiet_s = time.monotonic()
    time.sleep(2.0)
    readers = [visitors(lab, f"deaf{number}", "deaf") for number in range(4)]
    first = lab["w1"].memory_kb()
    begin = lab.mark("fault")
    for reader in readers:
        reader.order(ask=100)
    time.sleep(12.0)
    sizes = [lab["w1"].memory_kb()]
    for reader in readers:
        reader.kill()
    end = lab.mark("healed")
    left = wait_for_tasks(lab, 1)
    sizes.append(lab["w1"].memory_kb())
    time.sleep(1.0)
    verdict = of_bystander(lab, Verdict(lab, begin, end))
    verdict.note(latency_before_ms=latency(verdict, quiet_s, begin), latency_during_ms=latency(verdict, begin, end))
    verdict.note(longest_gap_ms=gap_ms(verdict, begin, end), tasks_left=left, memory_kb_and_fds=[first, *sizes])
    verdict.expect(left == 1, f"{left} tasks are left, 1 is the bystander's")
    return verdict.expect(verdict.notes["longest_gap_ms"] < 1000, f"the bystander waited {verdict.notes['longest_gap_ms']} ms")
