"""The tables of docs/numbers.md from the JSON that benches/numbers.sh wrote.

    python3 benches/tables.py runs/numbers                          # print them
    python3 benches/tables.py runs/numbers --into docs/numbers.md   # put them between their marks, and the plots beside it

A table stands between `<!-- NAME -->` and `<!-- end -->`. What was not measured leaves its table as it was.
"""

import argparse
import json
import pathlib
import re
import shutil

# The budgets, ms: (case, depth, order).
BUDGETS = {
    ("moved", "map", 8): 1.0,
    ("moved", "map", 16): 2.0,
    ("cached", "map", 8): 0.5,
    ("cached", "map", 16): 0.9,
    ("cached", "constant", 8): 0.2,
    ("cached", "constant", 16): 0.4,
}
PLOTS = {"sizes/step.svg": "sizes.svg", "orders/step.svg": "orders.svg", "tasks/load.svg": "tasks.svg"}


def rows_of(folder, name):
    return json.loads((folder / name).read_text())


def table(headings, rows):
    """Markdown; the first column is text, the others are numbers."""
    lines = ["| " + " | ".join(headings) + " |", "|---|" + "---:|" * (len(headings) - 1)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def short(number, digits=3):
    """As many significant digits; no dash where there is a number."""
    if number is None:
        return "–"
    return f"{number:.{digits}g}" if abs(number) < 100 else f"{number:.0f}"


def percent(fraction):
    return "–" if fraction is None else f"{100 * fraction:.0f} %"


def machine(folder):
    return "```\n" + (folder / "machine.txt").read_text().strip() + "\n```"


def budget(folder):
    lines = []
    both = zip(rows_of(folder, "budget/step.json"), adaptive_windows(folder))
    for row, adaptive in both:
        limit = BUDGETS.get((row["case"], row["depth"], row["order"]))
        name = f"{row['case']}, {row['depth']}, l = {row['order']}"
        lines.append([name, short(limit), short(row["median_ms"]), short(adaptive), short(row["p99_ms"]), short(row["frames_per_s"]),
                      short(row["gflops"]), percent(row["peak_fraction"])])
    peak = rows_of(folder, "budget/step.json")[0]
    said = f"One thread, {peak['path']}, 640x480; the core reached {peak['peak_gflops']:.0f} GFLOP/s with nothing but multiply-adds."
    headings = ["case", "budget ms", "median ms", "with an adaptive window", "p99 ms", "frames/s", "GFLOP/s", "of the peak"]
    return said + "\n\n" + table(headings, lines)


def adaptive_windows(folder):
    """The median under an adaptive window that stays beside each row of the budget; none where the window moves."""
    rows = rows_of(folder, "budget-adaptive-window/step.json")
    adaptive = {(row["depth"], row["order"]): row["median_ms"] for row in rows if row["case"] == "cached"}
    for row in rows_of(folder, "budget/step.json"):
        yield adaptive[row["depth"], row["order"]] if row["case"] == "cached" else None


def methods(folder):
    rows = rows_of(folder, "methods/step.json") + rows_of(folder, "pixels/step.json")
    lines = [[f"{row['method']}, {row['case']}, {row['depth']}", short(row["median_ms"]), short(row["p99_ms"]),
              short(row["frames_per_s"]), short(row["gflops"]), percent(row["peak_fraction"])] for row in rows]
    return table(["640x480, l = 16", "median ms", "p99 ms", "frames/s", "GFLOP/s", "of the peak"], lines)


def options(folder):
    lines = []
    for name in ("light", "noise-floor"):
        for row in rows_of(folder, f"options-{name}/step.json"):
            lines.append([f"--{name}, {row['case']}, {row['depth']}", short(row["median_ms"])])
    return table(["640x480, l = 16", "median ms"], lines)


def growth(folder):
    rows = [row for row in rows_of(folder, "sizes/step.json") if row["depth"] == "map"]
    sizes = list(dict.fromkeys(row["size"] for row in rows))
    keys = list(dict.fromkeys((row["case"], row["order"]) for row in rows))
    keys.sort()
    median = {(row["size"], row["case"], row["order"]): row["median_ms"] for row in rows}
    lines = []
    for size in sizes:
        lines.append([size] + [short(median.get((size, *key))) for key in keys])
    return table(["depth map, median ms"] + [f"{case}, l = {order}" for case, order in keys], lines)


def per_pixel(folder):
    rows = [row for row in rows_of(folder, "sizes/step.json") if row["depth"] == "map"]
    sizes = list(dict.fromkeys(row["size"] for row in rows))
    keys = sorted(dict.fromkeys((row["case"], row["order"]) for row in rows))
    lines = []
    for size in sizes:
        width, height = map(int, size.split("x"))
        of_size = {(row["case"], row["order"]): 1e6 * row["median_ms"] / (width * height) for row in rows if row["size"] == size}
        lines.append([size] + [short(of_size.get(key), 2) for key in keys])
    return table(["depth map, ns a pixel"] + [f"{case}, l = {order}" for case, order in keys], lines)


def paths(folder):
    lines = []
    for path in ("avx512", "avx2", "sse4.2", "sse2", "neon", "fallback"):
        file = folder / f"path-{path}" / "step.json"
        if file.exists():
            rows = json.loads(file.read_text())
            of_case = {(row["case"], row["depth"], row["order"]): row for row in rows}
            keys = [("moved", "map", 8), ("moved", "map", 16), ("cached", "map", 8), ("cached", "map", 16), ("cached", "constant", 16)]
            lines.append([path, short(rows[0]["peak_gflops"])] + [short(of_case[key]["median_ms"]) for key in keys])
    headings = ["path", "peak GFLOP/s", "moved map 8", "moved map 16", "cached map 8", "cached map 16", "cached constant 16"]
    return table(headings, lines)


def numpy(folder):
    lines = []
    for order in (8, 16):
        for row in rows_of(folder, f"numpy-{order}.json"):
            lines.append([f"{row['case']}, l = {order}", short(row["domvs_ms"]), short(row["numpy_plain_ms"]),
                          short(row["times_faster_than_plain"], 2), short(row["numpy_tuned_ms"]), short(row["times_faster_than_tuned"], 2)])
    return table(["640x480, depth map", "domvs ms", "numpy plain ms", "times", "numpy tuned ms", "times"], lines)


def roundtrip(folder):
    lines = [[f"{row['case']}, {row['depth']}, l = {row['order']}", short(row["median_ms"]), short(row["p99_ms"]), short(row["echo_ms"]),
              short(row["step_ms"]), short(row["queue_ms"]), short(row["overhead_ms"])]
             for row in rows_of(folder, "roundtrip/roundtrip.json") if row["case"] != "echo"]
    return table(["640x480", "median ms", "p99 ms", "echo ms", "step ms", "queue ms", "overhead ms"], lines)


def load(folder):
    lines = []
    for name, what in (("load", "20 tasks at 30 Hz"), ("overload", "20 tasks, three times too many frames")):
        for row in rows_of(folder, f"{name}/load.json"):
            lost = row["deadline_missed"] + row["other_status"] + row["unanswered"] + row["unsent"]
            lines.append([what, str(row["sent"]), str(row["servoing"]), str(row["overloaded"]), str(lost), short(row["median_ms"]),
                          short(row["p99_ms"]), short(row["echo_p99_ms"]), short(row["echo_beside_p99_ms"]), short(row["fairness"]),
                          short(row["worker_cores"])])
    headings = ["640x480, l = 8, constant depth", "frames", "twists", "overloaded", "lost", "median ms", "p99 ms", "echo p99 ms",
                "echo beside p99 ms", "fairness", "cores"]
    return table(headings, lines)


def memory(folder):
    lines = []
    for name in ("tasks", "load", "overload"):
        for row in rows_of(folder, f"{name}/load.json"):
            rss = row["worker_rss_mb"]
            if rss:
                during = rss["during"]
                lines.append([f"{row['tasks']} ({name})"] + [short(number) for number in
                              (rss["before"], rss["started"], during["begin"], during["peak"], during["end"], rss["closed"])])
    return table(["tasks", "no task yet", "started", "first frames", "peak", "last frames", "all closed"], lines)


def cores(folder):
    lines = []
    for ahead in (1, 3):
        for one, two in zip(rows_of(folder, f"one-core-{ahead}/load.json"), rows_of(folder, f"two-cores-{ahead}/load.json")):
            lines.append([f"{one['tasks']} at l = {one['order']}", str(ahead), short(one["frames_per_s"]), short(two["frames_per_s"]),
                          short(two["frames_per_s"] / one["frames_per_s"])])
    return table(["tasks, 640x480, constant depth", "frames of each that wait", "twists/s on one core", "on two", "ratio"], lines)


TABLES = [machine, budget, methods, options, growth, per_pixel, paths, numpy, roundtrip, load, memory, cores]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--into", type=pathlib.Path)
    args = parser.parse_args()
    text = args.into.read_text() if args.into else None
    for make in TABLES:
        try:
            made = make(args.folder)
        except FileNotFoundError as error:
            print(f"{make.__name__}: not measured ({error.filename})")
            continue
        if text is None:
            print(f"## {make.__name__}\n\n{made}\n")
            continue
        marks = re.compile(rf"(<!-- {make.__name__} -->\n)(?:(?!<!--).)*(<!-- end -->)", re.DOTALL)
        text, count = marks.subn(lambda found, made=made: found[1] + made + "\n" + found[2], text)
        if count != 1:
            print(f"{make.__name__}: {count} places in {args.into}")
    if text is not None:
        args.into.write_text(text)
        folder = args.into.parent / "numbers"
        folder.mkdir(exist_ok=True)
        for source, name in PLOTS.items():
            if (args.folder / source).exists():
                shutil.copy(args.folder / source, folder / name)


if __name__ == "__main__":
    main()
