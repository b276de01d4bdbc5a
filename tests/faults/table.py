"""The tables of docs/reliability.md, from the results that run.py wrote: the newest of each fault, in the order they came.

    python tests/faults/table.py tests/faults/results.jsonl docs/reliability.md
"""

import json
import pathlib
import sys

BEGIN, END = "<!-- from tests/faults/results.jsonl, by tests/faults/table.py -->", "<!-- end -->"
GROUPS = {
    "processes": "Processes that die or hang",
    "links": "Links that stall, break or lie",
    "order": "Frames out of order",
    "clocks": "Clocks that jump",
    "namespaces": "Hosts and cables (network namespaces, as root)",
    "disks": "Disks",
    "replicas": "More than one worker",
    "crowds": "Crowds",
}
# What the columns do not say; the facts of some faults, in words.
FACTS = {
    "clients": "clients, by what their twist said: {}",
    "tasks": "tasks, by what their twist said: {}",
    "seconds": "in {} s",
    "latency_before_ms": "a bystander's frame to command before: median, p99 {} ms",
    "latency_during_ms": "a bystander's frame to command: median, p99 {} ms",
    "longest_gap_ms": "longest gap between its commands {} ms",
    "tasks_left": "tasks left: {} (the bystander's)",
    "frames_hz": "frames {} /s",
    "commands_hz": "commands {} /s",
    "dropped": "dropped: {}",
    "memory_kb_and_fds": "KiB and file descriptors: {}",
    "steps": "after {} tasks",
}


def newest(path):
    """The last row of each fault."""
    rows = {}
    for line in path.read_text().splitlines():
        row = json.loads(line)
        rows.pop(row["name"], None)
        rows[row["name"]] = row
    return list(rows.values())


def ms(value):
    return "–" if value is None else f"{value} ms"


def lost(row):
    """Frames without an answer, in the fault's time and outside of it; whether the task was kept."""
    if "frames" not in row:
        return "–"
    kept = {True: "task kept", False: "**task changed**", None: ""}[row.get("state_kept")]
    frames = f"{row['unanswered_during']} of {row['frames']} frames"
    if row["unanswered_else"]:
        frames += f", {row['unanswered_else']} more later"
    return ", ".join(part for part in (frames, kept) if part)


def reported(row):
    words = [f"`{word}`" for word in row.get("reported", [])]
    words += [f"arm: {why} ({count})" for why, count in row.get("refused_by_arm", {}).items() if why != "the arm stood still"]
    return ", ".join(words) or "–"


def plain(value):
    """Numbers and lists of a fact as words."""
    if isinstance(value, dict):
        return ", ".join(f"{count} {word}" for word, count in value.items() if count) or "none"
    if isinstance(value, list):
        return ", ".join(f"({plain(part)})" if isinstance(part, list) else plain(part) for part in value)
    return str(value)


def facts(row):
    told = [words.format(plain(row[name])) for name, words in FACTS.items() if row.get(name) is not None]
    told += [f"{name.replace('_', ' ')}: {plain(value)}" for name, value in row.get("facts", {}).items()]
    return "; ".join(told)


def of_group(rows):
    lines = ["| fault | arm at rest | moves again | oldest frame moved on | without an answer | what it says | verdict |"]
    lines.append("|---|---|---|---|---|---|---|")
    for row in rows:
        verdict = "kept" if not row["wrong"] else f"**{len(row['wrong'])} wrong**: {row['wrong'][0]}"
        cells = [row["name"], ms(row.get("zero_ms")), ms(row.get("recover_ms")), ms(row.get("oldest_ms")), lost(row), reported(row), verdict]
        lines.append("| " + " | ".join(cells) + " |")
    told = [f"- {row['name']}: {facts(row)}." for row in rows if facts(row)]
    return lines + ([""] + told if told else [])


def tables(rows):
    """All groups, and where and when."""
    lines = []
    for group, title in GROUPS.items():
        mine = [row for row in rows if row["group"] == group]
        if mine:
            lines += ["", f"### {title}", "", *of_group(mine)]
    wrong = sum(bool(row["wrong"]) for row in rows)
    dates = sorted({row["date"] for row in rows})
    machines = sorted({row["machine"].split(", load")[0] for row in rows})
    loads = [float(row["machine"].rsplit(" ", 1)[1]) for row in rows]
    head = [f"{len(rows)} faults, {wrong} with something wrong. {' to '.join(sorted({dates[0], dates[-1]}))}, {'; '.join(machines)};"]
    head.append(f"load while they ran {min(loads)} to {max(loads)}, as the machine did other work.")
    return head + lines


def write(results, page):
    """Puts the tables between the two marks of the page."""
    text = page.read_text()
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    page.write_text("\n".join([before + BEGIN, *tables(newest(results)), END]) + after)


if __name__ == "__main__":
    write(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]))
