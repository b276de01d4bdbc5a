"""Real hosts on one machine: network namespaces with veth pairs, cut by `ip link set down`, made lossy by nftables. Needs root.

The laboratory's router and the judge live in a namespace of their own, which `run.py --root` has entered with `unshare`; each
other process gets one, with one cable to the router.
"""

import subprocess
import time

import replicas
import wire
from cases import RECOVERY_S, broken, fault, start_again, state, verdict_of

PORT = 7447


def run(*command):
    """A command that must succeed."""
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(map(str, command))}: {done.stderr.strip()}"


def forget(space, cable):
    """The cable first: the kernel takes its time with those of a namespace that is gone."""
    subprocess.run(["ip", "link", "del", cable], capture_output=True)
    subprocess.run(["ip", "netns", "del", space], capture_output=True)


class Hosts:
    """One namespace for each name; number n has 10.77.n.2, the router's end of its cable 10.77.n.1."""

    def __init__(self, names):
        self.numbers = {name: number for number, name in enumerate(names, 1)}
        for name, number in self.numbers.items():
            space, cable = f"dvf-{name}", f"dvf{number}"
            forget(space, cable)
            run("ip", "netns", "add", space)
            run("ip", "link", "add", cable, "type", "veth", "peer", "name", "eth0", "netns", space)
            run("ip", "addr", "add", f"10.77.{number}.1/24", "dev", cable)
            run("ip", "link", "set", cable, "up")
            self.inside(name, "ip", "addr", "add", f"10.77.{number}.2/24", "dev", "eth0")
            self.inside(name, "ip", "link", "set", "eth0", "up")
            self.inside(name, "ip", "link", "set", "lo", "up")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for name, number in self.numbers.items():
            forget(f"dvf-{name}", f"dvf{number}")

    def within(self, name):
        """What a command is prefixed with to run there."""
        return ["ip", "netns", "exec", f"dvf-{name}"]

    def inside(self, name, *command):
        run(*self.within(name), *command)

    def router(self, name):
        """The router's endpoint as this host sees it."""
        return f"tcp/10.77.{self.numbers[name]}.1:{PORT}"

    def cut(self, name):
        run("ip", "link", "set", f"dvf{self.numbers[name]}", "down")

    def heal(self, name):
        run("ip", "link", "set", f"dvf{self.numbers[name]}", "up")

    def drop(self, name, way, rule):
        """Drops packets of this host, `way` is input or output: "" for all, or such as "numgen random mod 100 < 10"."""
        self.inside(name, "nft", "add table inet lab")
        self.inside(name, "nft", f"add chain inet lab {way} {{ type filter hook {way} priority 0; }}")
        self.inside(name, "nft", f"add rule inet lab {way} {rule} drop")

    def let(self, name):
        self.inside(name, "nft", "delete table inet lab")


def spread(lab, hosts, workers=("w1",), settings="{}"):
    """Everybody on a host of their own, servoing."""
    lab.router(f"tcp/0.0.0.0:{PORT}")
    for name in workers:
        lab.worker(name, joins=hosts.router(name), within=hosts.within(name))
    lab.watch()
    wire.wait_for_workers(lab.session, len(workers))
    for name in ("client", "arm", "camera"):
        arguments = ("--settings", settings) if name == "client" else ()
        start = {"client": lab.owner, "arm": lab.arm, "camera": lab.camera}[name]
        start(*arguments, endpoint=hosts.router(name), within=hosts.within(name))
    lab.steady()


def on_hosts(name, break_it, heal_it, seconds, who, quick=False):
    """Registers a fault of one host's cable."""

    def tried(lab):
        lab.endpoint = f"tcp/127.0.0.1:{PORT}"
        with Hosts(("w1", "client", "arm", "camera")) as hosts:
            spread(lab, hosts)
            before = state(lab)

            def heal():
                heal_it(hosts)
                if who in ("client", "w1") and seconds >= 1:
                    start_again(lab)

            return verdict_of(lab, broken(lab, lambda: break_it(hosts), heal, seconds), before).judge()

    tried.__doc__ = name
    fault("namespaces", quick=quick)(tried)


WORDS = {"camera": "the camera's host", "arm": "the arm's host", "client": "the client's host", "w1": "the worker's host"}
LOSS = "numgen random mod 100 < 10"


def lossy(hosts, who):
    hosts.drop(who, "input", LOSS)
    hosts.drop(who, "output", LOSS)


@fault("namespaces")
def owner_cut(lab):
    """cable of the owner's host cut for 5 s, with another worker on another host"""
    lab.endpoint = f"tcp/127.0.0.1:{PORT}"
    with Hosts(("w1", "w2", "client", "arm", "camera")) as hosts:
        spread(lab, hosts, workers=("w1", "w2"))
        before = state(lab)
        worker, epoch = replicas.owner(lab)
        begin = lab.mark("fault")
        hosts.cut(worker)
        heir, _, times = replicas.takeover(lab, begin, epoch)
        time.sleep(max(0.0, begin + 5.0 - time.monotonic()))
        healed = lab.mark("healed")
        hosts.heal(worker)
        lab.wait_for_motion(healed, RECOVERY_S)
        wire.wait_for_workers(lab.session, 2)
        time.sleep(2.0)
        verdict = verdict_of(lab, (begin, healed), before)
        now = replicas.owner(lab)[0]
        verdict.expect(now == heir, f"{heir} took the task, and after the healing {now} has it")
        return verdict.note(facts={**times, "old_epoch_commands": replicas.old_epochs(verdict)}).judge()


@fault("namespaces")
def split(lab):
    """two sites, each with router and worker, cut apart for 5 s: the owner and the arm here, camera and client there"""
    lab.endpoint = f"tcp/127.0.0.1:{PORT}"
    with Hosts(("far",)) as hosts:
        lab.router(f"tcp/0.0.0.0:{PORT}")
        there, site = f"tcp/127.0.0.1:{PORT}", {"within": hosts.within("far")}
        connect = ["--connect", hosts.router("far")]
        lab.start("far router", lab.python("router.py", f"tcp/0.0.0.0:{PORT}", *connect), **site)
        lab.worker("w1", joins=lab.endpoint)
        lab.worker("w2", joins=there, **site)
        lab.watch()
        wire.wait_for_workers(lab.session, 2)
        lab.owner("--worker", "w1", endpoint=there, **site)
        lab.arm()
        lab.camera(endpoint=there, **site)
        lab.steady(2.0)
        before = state(lab)
        begin = lab.mark("fault")
        hosts.cut("far")
        time.sleep(5.0)
        healed = lab.mark("healed")
        hosts.heal("far")
        lab.wait_for_motion(healed, RECOVERY_S)
        time.sleep(3.0)
        verdict = verdict_of(lab, (begin, healed), before)
        return verdict.note(facts={"owner afterwards": replicas.owner(lab)[0], "old_epoch_commands": replicas.old_epochs(verdict)}).judge()


def register():
    for who, words in WORDS.items():
        for seconds in (0.5, 5.0):
            name = f"cable of {words} cut for {seconds:g} s"
            on_hosts(name, lambda hosts, who=who: hosts.cut(who), lambda hosts, who=who: hosts.heal(who), seconds, who)
        name = f"{words} cannot send for 3 s, but hears"
        on_hosts(name, lambda hosts, who=who: hosts.drop(who, "output", ""), lambda hosts, who=who: hosts.let(who), 3.0, who)
        name = f"{words} cannot hear for 3 s, but sends"
        on_hosts(name, lambda hosts, who=who: hosts.drop(who, "input", ""), lambda hosts, who=who: hosts.let(who), 3.0, who)
    for who in ("camera", "w1"):
        name = f"10 % of all packets of {WORDS[who]} lost, both ways, for 10 s"
        on_hosts(name, lambda hosts, who=who: lossy(hosts, who), lambda hosts, who=who: hosts.let(who), 10.0, who)


register()
