"""The faults: each one function that builds its laboratory, breaks something, heals it, and returns its verdict.

The first line of its documentation is its name in the table; `@fault` says in which group it runs.
"""

import json
import time

import wire
from judge import Verdict

FAULTS = []
RECOVERY_S = 20.0


def fault(group, quick=False):
    """Registers a fault. `quick`: it is one of those that `.ci/run` tries."""

    def register(function):
        FAULTS.append({"name": function.__doc__.splitlines()[0].rstrip("."), "run": function, "group": group, "quick": quick})
        return function

    return register


def alone(lab, *arguments, settings=None, owners=True, camera=()):
    """One worker that is its own router; client, arm and camera beside it."""
    lab.worker("w1", *arguments)
    people(lab, settings=settings, owners=owners, camera=camera)


def routed(lab, workers=("w1",), settings=None):
    """A router of its own, and workers that join it."""
    lab.router()
    for name in workers:
        lab.worker(name, joins=lab.endpoint)
    people(lab, workers=len(workers), settings=settings)


def people(lab, workers=1, settings=None, through=None, owners=True, camera=()):
    """The judge, a client, an arm and a camera, servoing; `through` names endpoints for some of them."""
    through = through or {}
    lab.watch(owners)
    wire.wait_for_workers(lab.session, workers)
    lab.owner("--settings", json.dumps(settings or {}), endpoint=through.get("client"))
    lab.arm(endpoint=through.get("arm"))
    lab.camera(*camera, endpoint=through.get("camera"))
    lab.steady()


def proxied(lab, who, settings=None, camera=()):
    """As `routed`, with a proxy in the link of `who`: camera, arm, client or worker."""
    lab.router()
    near = lab.proxy()
    lab.worker("w1", joins=near if who == "worker" else lab.endpoint)
    people(lab, through={who: near}, settings=settings, camera=camera)


def broken(lab, break_it, heal_it, seconds, after_s=1.0, wait=True):
    """Breaks, waits, heals, waits for motion and a little longer; returns when it broke and healed."""
    begin = lab.mark("fault")
    break_it()
    time.sleep(seconds)
    healed = lab.mark("healed")
    heal_it()
    if wait:
        lab.wait_for_motion(healed, RECOVERY_S)
    time.sleep(after_s)
    return begin, healed


def kept(lab, before):
    """What must have outlived the fault: settings and target, unchanged, under the same secret."""
    settings, target = before
    return {"state_kept": wire.settings_of(lab.session, lab.task) == settings and wire.target_of(lab.session, lab.task) == target}


def state(lab):
    return wire.settings_of(lab.session, lab.task), wire.target_of(lab.session, lab.task)


def verdict_of(lab, times, before=None, **options):
    verdict = Verdict(lab, *times, **options)
    if before is not None:
        verdict.note(**kept(lab, before)).expect(verdict.notes["state_kept"], "settings or target have changed")
    return verdict


# Processes.


@fault("processes", quick=True)
def camera_killed(lab):
    """kill -9 of the camera, another after 1 s"""
    alone(lab)
    before = state(lab)
    return verdict_of(lab, broken(lab, lambda: lab.kill("camera"), lab.camera, 1.0), before)


@fault("processes", quick=True)
def camera_stopped(lab):
    """SIGSTOP of the camera for 5 s"""
    alone(lab)
    before = state(lab)
    return verdict_of(lab, broken(lab, lambda: lab.pause("camera"), lambda: lab.resume("camera"), 5.0), before)


@fault("processes")
def arm_killed(lab):
    """kill -9 of the arm's controller, another after 1 s"""
    alone(lab)
    return verdict_of(lab, broken(lab, lambda: lab.kill("arm"), lab.arm, 1.0))


@fault("processes", quick=True)
def arm_stopped(lab):
    """SIGSTOP of the arm's controller for 5 s"""
    alone(lab)
    return verdict_of(lab, broken(lab, lambda: lab.pause("arm"), lambda: lab.resume("arm"), 5.0))


@fault("processes", quick=True)
def client_killed(lab):
    """kill -9 of the client; it comes back after 1 s and starts its task again"""
    alone(lab)
    before = state(lab)

    def again():
        lab.owner("--again", lab.task["task"], lab.task["secret"])

    return verdict_of(lab, broken(lab, lambda: lab.kill("client"), again, 1.0), before)


@fault("processes")
def client_stopped(lab):
    """SIGSTOP of the client for 5 s; then it starts its task again"""
    alone(lab)
    before = state(lab)

    def resume():
        lab.resume("client")
        give_up = time.monotonic() + RECOVERY_S
        while wire.control(lab.session, lab.task, "start") == "client_lost" and time.monotonic() < give_up:
            time.sleep(0.02)

    return verdict_of(lab, broken(lab, lambda: lab.pause("client"), resume, 5.0), before)


@fault("processes", quick=True)
def worker_killed(lab):
    """kill -9 of the only worker, another after 1 s; the client makes its task anew"""
    routed(lab)

    def again():
        lab.worker("w1", joins=lab.endpoint)
        wire.wait_for_workers(lab.session)
        lab.kill("client")
        lab.kill("arm")
        lab.kill("camera")
        lab.owner()
        lab.arm()
        lab.camera()

    return verdict_of(lab, broken(lab, lambda: lab.kill("w1"), again, 1.0))


@fault("processes", quick=True)
def worker_stopped(lab):
    """SIGSTOP of the only worker for 5 s"""
    routed(lab)
    before = state(lab)

    def resume():
        lab.resume("w1")
        start_again(lab)

    return verdict_of(lab, broken(lab, lambda: lab.pause("w1"), resume, 5.0), before)


@fault("processes")
def worker_stopped_shortly(lab):
    """SIGSTOP of the only worker for 0.5 s, shorter than the lease"""
    routed(lab)
    before = state(lab)
    return verdict_of(lab, broken(lab, lambda: lab.pause("w1"), lambda: lab.resume("w1"), 0.5), before)


@fault("processes", quick=True)
def router_killed(lab):
    """kill -9 of the router, another after 1 s"""
    routed(lab)
    before = state(lab)

    def again():
        lab.router()
        start_again(lab)

    return verdict_of(lab, broken(lab, lambda: lab.kill("router"), again, 1.0), before)


@fault("processes")
def router_gone(lab):
    """kill -9 of the router, another after 8 s"""
    routed(lab)
    before = state(lab)

    def again():
        lab.router()
        start_again(lab)

    return verdict_of(lab, broken(lab, lambda: lab.kill("router"), again, 8.0), before)


@fault("processes")
def router_stopped(lab):
    """SIGSTOP of the router for 5 s"""
    routed(lab)
    before = state(lab)

    def resume():
        lab.resume("router")
        start_again(lab)

    return verdict_of(lab, broken(lab, lambda: lab.pause("router"), resume, 5.0), before)


def start_again(lab):
    """What a client does that finds its task halted with `client_lost`: waits for its token to be seen, and starts."""
    give_up = time.monotonic() + RECOVERY_S
    while time.monotonic() < give_up:
        try:
            if wire.control(lab.session, lab.task, "resume", limit_s=RECOVERY_S) not in ("client_lost",):
                return
        except wire.Refused as refused:
            if refused.code != "unknown_task":
                raise
        time.sleep(0.02)


# Links, by a proxy in front of the router.


def link_faults():
    """One fault for each kind and each process; the kinds are the same for all of them."""
    kinds = [
        ("a stall of 0.6 s of {}, then all that waited", {"stall": ["up", "down"]}, {"stall": []}, 0.6),
        ("a stall of 5 s of {}", {"stall": ["up", "down"]}, {"stall": []}, 5.0),
        ("a reset (RST) of {}, refused for 1 s", {"closed": True, "reset": True}, {"closed": False}, 1.0),
        ("{} half-open for 3 s: closed at the router, silence to the other side", {"half": True}, {}, 3.0),
        ("{} deaf for 3 s: what it sends is lost, what is sent to it comes", {"swallow": ["up"]}, {"swallow": []}, 3.0),
    ]
    links = [("camera", "the camera's link"), ("arm", "the arm's link"), ("client", "the client's link"), ("worker", "the worker's link")]
    for who, words in links:
        for kind, bad, good, seconds in kinds:
            register_link(who, kind.format(words), bad, good, seconds)


def register_link(who, name, bad, good, seconds):
    def run(lab):
        proxied(lab, who)
        before = state(lab)

        def heal():
            lab["proxy"].order(**good)
            if who in ("client", "worker") and seconds >= 1:
                start_again(lab)

        return verdict_of(lab, broken(lab, lambda: lab["proxy"].order(**bad), heal, seconds), before)

    run.__doc__ = name
    fault("links", quick=(who, seconds) in {("camera", 0.6), ("worker", 5.0)})(run)


link_faults()


@fault("links")
def blind_camera_stalled(lab):
    """a stall of 0.6 s of the link of a camera that tells no capture time"""
    proxied(lab, "camera", camera=("--blind",))
    stall = lambda ways: lab["proxy"].order(stall=ways)  # noqa: E731
    return verdict_of(lab, broken(lab, lambda: stall(["up", "down"]), lambda: stall([]), 0.6))


@fault("processes")
def worker_stopped_blind(lab):
    """SIGSTOP for 5 s of a worker that is its own router, with a camera that tells no capture time"""
    alone(lab, camera=("--blind",))

    def resume():
        lab.resume("w1")
        start_again(lab)

    return verdict_of(lab, broken(lab, lambda: lab.pause("w1"), resume, 5.0))


@fault("processes")
def worker_stopped_alone(lab):
    """SIGSTOP for 5 s of a worker that is its own router"""
    alone(lab)

    def resume():
        lab.resume("w1")
        start_again(lab)

    return verdict_of(lab, broken(lab, lambda: lab.pause("w1"), resume, 5.0))


@fault("links")
def camera_delayed(lab):
    """200 ms of delay on the camera's link, from one moment on"""
    return delayed(lab, "camera")


@fault("links")
def worker_delayed(lab):
    """200 ms of delay on the worker's link, from one moment on"""
    return delayed(lab, "worker")


def delayed(lab, who):
    """A delay that begins is seen as age at once; after 10 s it is the way's own, and cannot be told from another clock."""
    proxied(lab, who)
    begin = lab.mark("fault")
    lab["proxy"].order(delay_s=0.2)
    time.sleep(14.0)
    lab["proxy"].order(delay_s=0.0)
    healed = lab.mark("healed")
    lab.wait_for_motion(healed, RECOVERY_S)
    time.sleep(1.0)
    way_s = 0.2 if who == "camera" else 0.4
    return verdict_of(lab, (begin, healed), way_s=way_s)


@fault("links")
def delay_creeps(lab):
    """a delay on the camera's link that grows by 30 ms a second, up to 0.9 s"""
    proxied(lab, "camera")
    begin = lab.mark("fault")
    for step in range(90):
        lab["proxy"].order(delay_s=0.01 * step)
        time.sleep(0.333)
    lab["proxy"].order(delay_s=0.0)
    healed = lab.mark("healed")
    lab.wait_for_motion(healed, RECOVERY_S)
    time.sleep(1.0)
    return verdict_of(lab, (begin, healed))


# Order, by a relay of messages.


def relayed(lab, mode, lasts_s, **order):
    lab.router()
    lab.worker("w1", joins=lab.endpoint)
    lab.watch()
    wire.wait_for_workers(lab.session)
    lab.owner()
    frame_key = f"{lab.task['task']}/frame"
    lab.start("relay", lab.python("relay.py", "--endpoint", lab.endpoint, "--source", "lab/frames", "--target", frame_key))
    lab.arm()
    lab.camera("--key", "lab/frames")
    lab.steady()
    before = state(lab)
    spoil = lambda: lab["relay"].order(mode=mode, **order)  # noqa: E731
    return verdict_of(lab, broken(lab, spoil, lambda: lab["relay"].order(mode="plain"), lasts_s), before)


@fault("order", quick=True)
def swapped(lab):
    """every second frame after its successor, for 3 s"""
    return relayed(lab, "swap", 3.0)


@fault("order", quick=True)
def twice(lab):
    """every frame twice, and once more 0.4 s later, for 3 s"""
    return relayed(lab, "twice", 3.0)


@fault("order")
def late_copies(lab):
    """every frame again 2 s later, among the fresh ones, for 5 s"""
    return relayed(lab, "late", 5.0, seconds=2.0)


@fault("order")
def shuffled(lab):
    """frames held back and sent eight at a time in any order, for 3 s"""
    return relayed(lab, "shuffle", 3.0)


# Clocks.


def clock_faults():
    for seconds in (3600.0, -3600.0, 0.3, -0.3):
        register_clock(seconds)


def register_clock(seconds):
    def run(lab):
        alone(lab)
        before = state(lab)
        begin = lab.mark("fault")
        lab.clock_s = seconds
        lab["camera"].order(clock_s=seconds)
        lab.wait_for_motion(begin + 0.1, RECOVERY_S)
        time.sleep(1.0)
        return verdict_of(lab, (begin, begin), before)

    size = f"{seconds / 3600:+.0f} h" if abs(seconds) > 60 else f"{seconds:+.1f} s"
    run.__doc__ = f"the camera's clock jumps by {size}"
    fault("clocks", quick=abs(seconds) > 60)(run)


clock_faults()
