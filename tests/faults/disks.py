"""Disks that are full or may not be written to. Needs root: a small tmpfs is mounted in the run's own mount namespace."""

import subprocess
import time

import wire
from cases import alone, fault, state, verdict_of


class Disk:
    """A tmpfs in the laboratory's folder; gone at the end."""

    def __init__(self, folder, options):
        self.path = folder / "disk"
        self.path.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", self.path], check=True)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        subprocess.run(["umount", "-l", self.path], check=True)

    def options(self, options):
        subprocess.run(["mount", "-o", f"remount,{options}", self.path], check=True)


def said(lab):
    """The lines of warnings and errors of the worker, without their time, each once."""
    lines = lab["w1"].last_words().splitlines()
    words = [line.split(None, 1)[1] for line in lines if " WARN " in line or "ERROR" in line]
    return list(dict.fromkeys(words))[-2:]


def watched(lab, begin, seconds):
    """Servoing goes on as if nothing were; what the log says."""
    before = state(lab)
    time.sleep(seconds)
    lab.wait_for_motion(time.monotonic())
    time.sleep(0.5)
    verdict = verdict_of(lab, (begin, begin), before)
    verdict.note(facts={"log": said(lab) or "nothing"})
    return verdict.expect(said(lab), "the log says nothing")


@fault("disks")
def recording_full(lab):
    """the recording's disk full: 2 MB, some 5 s of frames"""
    with Disk(lab.folder, "size=2m") as disk:
        alone(lab, "--record", disk.path)
        return watched(lab, lab.mark("fault"), 10.0).judge()


@fault("disks")
def recording_read_only(lab):
    """a worker started with a recording on a read-only disk"""
    return refused(lab, "--record")


def refused(lab, option):
    """It must say so and end, rather than serve without what it was told to do."""
    with Disk(lab.folder, "ro") as disk:
        process = lab.worker("w1", option, disk.path)
        code = process.process.wait(10)
    words = process.last_words()
    wrong = [] if code not in (0, None) and str(disk.path) in words else [f"exit code {code}: {words}"]
    return {"wrong": wrong, "facts": {"exit code": code, "error": words.replace(str(disk.path), "FOLDER").splitlines()[-1:]}}


@fault("disks")
def state_read_only(lab):
    """a worker started with a state directory on a read-only disk"""
    return refused(lab, "--state")


@fault("disks")
def state_full(lab):
    """the state directory's disk full before the task is made: 100 kB, all taken"""
    with Disk(lab.folder, "size=100k") as disk:
        lab.worker("w1", "--state", disk.path)
        lab.watch()
        wire.wait_for_workers(lab.session)
        fill(disk.path / "ballast")
        lab.owner()
        lab.arm()
        lab.camera()
        lab.steady()
        verdict = watched(lab, lab.mark("fault"), 3.0)
        told = wire.workers(lab.session)[0].get("state_error")
        verdict.expect(told, "the worker's info does not say that its tasks cannot be saved")
        verdict.notes["facts"]["worker info"] = str(told).replace(str(disk.path), "FOLDER")
        return verdict.judge()


def fill(path):
    """Takes all the room there is."""
    with path.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(4096))
        except OSError:
            pass
