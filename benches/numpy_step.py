"""The same step in numpy, beside `domvs bench step`: same images, same twist, one thread each, in turns.

    python benches/numpy_step.py target/release/domvs --size 640x480 --order 16

What is compared is a step of Hahn moments with a depth for every pixel: seven planes (the image and its six columns of the
interaction matrix), all projected by `HY @ (planes @ HX.T)` in single precision through OpenBLAS, then `lstsq`. Two cases, as
`domvs bench step` has them:

    cached  the window stays: bases and the desired view's projections are kept, one view is computed
    moved   the window moves: both bases (three-term recurrences, vectorised over pixels) and both views are computed

each in two styles: `plain`, as one writes numpy, an expression for each plane; and `tuned`, with every buffer made before the
clock starts, every operation in place, and what columns share computed once.

numpy is spared what Domvs does besides: finding the window from the images' brightness (moved windows are given to it), the pixel
error, and the condition number. Before anything is timed, the twist is held against `domvs twist` (double precision): within 1e-9 of
it for this code in double precision, which proves that it computes the same thing, and within 1e-3 for single precision.

Needs benches/requirements.txt. Exit code 1 if a twist differs, or with --at-least R if Domvs is not R times faster than the plain
style in both cases.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

# Before numpy is loaded: one thread each.
for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

import numpy as np
from PIL import Image

WINDOWS = [(8.0, 8.0), (9.0, 7.0)]
MM = 0.001
STYLES = ("plain", "tuned")


def hahn_rows(count, pixels, window):
    """`count` rows, orthonormal under the weight w(u)/w(u-1) = (b + u)(N - u) / (u (N + a - u)): the Stieltjes procedure."""
    a, b = window
    u = np.arange(1, pixels, dtype=np.float64)
    ratios = (b + u) / u * (pixels - u) / (pixels + a - u)
    root = np.exp(0.5 * np.concatenate([[0.0], np.cumsum(np.log(ratios))]))
    x = np.linspace(-1.0, 1.0, pixels)
    rows = np.empty((count, pixels))
    rows[0] = root / np.linalg.norm(root)
    before, link = np.zeros(pixels), 0.0
    for n in range(1, count):
        row = rows[n - 1]
        moved = x * row
        following = moved - (moved @ row) * row - link * before
        link = np.linalg.norm(following)
        rows[n] = following / link
        before = row
    return rows


class View:
    """Seven planes of one image and depth: I, then the six columns of L_I, in buffers of their own."""

    def __init__(self, image, depth_m, camera, dtype):
        fx, fy, cx, cy = camera
        height, width = image.shape
        self.image, self.depth_m = image.astype(dtype), depth_m.astype(dtype)
        self.focal = (dtype(fx), dtype(fy))
        self.x = ((np.arange(width) - cx) / fx).astype(dtype)[None, :]
        self.y = ((np.arange(height) - cy) / fy).astype(dtype)[:, None]
        self.planes = np.empty((7, height, width), dtype)
        self.along_u, self.along_v = np.empty((height, width), dtype), np.empty((height, width), dtype)
        self.turn, self.product = np.empty((height, width), dtype), np.empty((height, width), dtype)

    def plain(self):
        """np.gradient's differences; the columns are -(I_x L_x + I_y L_y) of a point's motion."""
        (fx, fy), x, y, depth_m = self.focal, self.x, self.y, self.depth_m
        iy, ix = np.gradient(self.image)
        ix, iy = fx * ix, fy * iy
        return np.stack([
            self.image,
            ix / depth_m,
            iy / depth_m,
            -(x * ix + y * iy) / depth_m,
            -(x * y * ix + (1 + y * y) * iy),
            (1 + x * x) * ix + x * y * iy,
            x * iy - y * ix,
        ])

    def tuned(self):
        """The same seven, in place."""
        image, ix, iy, (fx, fy) = self.image, self.along_u, self.along_v, self.focal
        planes, turn, product, x, y = self.planes, self.turn, self.product, self.x, self.y
        np.subtract(image[:, 2:], image[:, :-2], out=ix[:, 1:-1])
        ix[:, 1:-1] *= fx / 2
        ix[:, 0], ix[:, -1] = fx * (image[:, 1] - image[:, 0]), fx * (image[:, -1] - image[:, -2])
        np.subtract(image[2:], image[:-2], out=iy[1:-1])
        iy[1:-1] *= fy / 2
        iy[0], iy[-1] = fy * (image[1] - image[0]), fy * (image[-1] - image[-2])

        planes[0] = image
        np.divide(ix, self.depth_m, out=planes[1])
        np.divide(iy, self.depth_m, out=planes[2])
        # x I_x + y I_y stands in three columns.
        np.multiply(ix, x, out=turn)
        np.multiply(iy, y, out=product)
        turn += product
        np.divide(turn, self.depth_m, out=planes[3])
        np.negative(planes[3], out=planes[3])
        np.multiply(turn, y, out=planes[4])
        planes[4] += iy
        np.negative(planes[4], out=planes[4])
        np.multiply(turn, x, out=planes[5])
        planes[5] += ix
        np.multiply(iy, x, out=planes[6])
        np.multiply(ix, y, out=product)
        planes[6] -= product
        return planes


class Servo:
    """The law: what `domvs bench step` calls a step."""

    def __init__(self, desired, order, dtype, style):
        self.desired, self.order, self.dtype, self.planes = desired, order, dtype, getattr(View, style)
        degrees = np.arange(order + 1)
        self.kept = degrees[:, None] + degrees[None, :] <= order
        self.use_window(WINDOWS[0])

    def use_window(self, window):
        height, width = self.desired.image.shape
        self.hx = np.ascontiguousarray(hahn_rows(self.order + 1, width, window).T.astype(self.dtype))
        self.hy = hahn_rows(self.order + 1, height, window).astype(self.dtype)
        self.desired_moments = self.project(self.desired)

    def project(self, view):
        return self.hy @ (self.planes(view) @ self.hx)

    def step(self, current):
        moments = self.project(current)
        error = (moments[0] - self.desired_moments[0])[self.kept]
        interaction = 0.5 * (moments[1:] + self.desired_moments[1:])[:, self.kept].T
        return -np.linalg.lstsq(interaction, error, rcond=None)[0]


def run(domvs, *arguments):
    done = subprocess.run([domvs, *arguments], check=True, capture_output=True, text=True)
    return done.stdout


def read(folder, name):
    """Gray in [0, 1] and depth in metres, double precision."""
    gray = np.asarray(Image.open(folder / f"{name}.png"), np.float64) / 255
    return gray, np.asarray(Image.open(folder / f"{name}_depth.png"), np.float64) * MM


def camera_of(width, height):
    """The camera of `domvs bench`."""
    focal = 0.95 * max(width, height)
    return focal, focal, (width - 1) / 2, (height - 1) / 2


def difference(twist, expected):
    return float(np.linalg.norm(np.asarray(twist, np.float64) - expected) / np.linalg.norm(expected))


def check(domvs, folder, views, order, camera):
    """The same twist as the program's, in both precisions and for both windows."""
    for window in WINDOWS:
        files = ["--desired", f"{folder}/desired.png", "--current", f"{folder}/current.png"]
        depths = ["--desired-depth", f"{folder}/desired_depth.png", "--current-depth", f"{folder}/current_depth.png"]
        law = ["--order", str(order), "--window", ",".join(map(str, window)), "--camera", ",".join(map(repr, camera))]
        expected = np.array(json.loads(run(domvs, "twist", "--json", *files, *depths, *law))["twist"])
        for style in STYLES:
            for dtype, tolerance in ((np.float64, 1e-9), (np.float32, 1e-3)):
                servo = Servo(View(*views["desired"], camera, dtype), order, dtype, style)
                servo.use_window(window)
                found = difference(servo.step(View(*views["current"], camera, dtype)), expected)
                case = f"{style}, {dtype.__name__}, window {window}"
                if not found < tolerance:
                    sys.exit(f"another twist: {case} differs by {found:.1e} of it, at most {tolerance}")
                print(f"same twist: {case} within {found:.1e}", file=sys.stderr)


def time_numpy(servo, currents, case, steps):
    """Milliseconds of so many steps; one more goes before them."""
    times = []
    for index in range(steps + 1):
        current = currents[index % 2 if case == "moved" else 0]
        begin = time.perf_counter()
        if case == "moved":
            servo.use_window(WINDOWS[index % 2])
        servo.step(current)
        times.append(1e3 * (time.perf_counter() - begin))
    return times[1:]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("domvs", help="the program, built with --release")
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--order", type=int, default=16)
    parser.add_argument("--rounds", type=int, default=6, help="how often the two take turns")
    parser.add_argument("--steps", type=int, default=20, help="steps of numpy in a turn; Domvs makes three times as many")
    parser.add_argument("--at-least", type=float, default=0.0, metavar="R")
    parser.add_argument("--json", action="store_true", help="one JSON array on standard output")
    args = parser.parse_args()
    width, height = map(int, args.size.split("x"))
    camera = camera_of(width, height)
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        run(args.domvs, "bench", "images", "--size", args.size, "--out", str(folder))
        views = {name: read(folder, name) for name in ("desired", "current", "moved")}
        check(args.domvs, folder, views, args.order, camera)
    f32 = np.float32
    servos = {style: Servo(View(*views["desired"], camera, f32), args.order, f32, style) for style in STYLES}
    currents = [View(*views[name], camera, f32) for name in ("current", "moved")]
    times = {case: {who: [] for who in (*STYLES, "domvs")} for case in ("moved", "cached")}
    for _ in range(args.rounds):
        for case, of_case in times.items():
            for style, servo in servos.items():
                of_case[style] += time_numpy(servo, currents, case, args.steps)
        case = ["--size", args.size, "--order", str(args.order), "--depth", "map", "--steps", str(3 * args.steps)]
        for row in json.loads(run(args.domvs, "bench", "step", "--json", *case)):
            times[row["case"]]["domvs"].append(row["median_ms"])
    rows = []
    for case, of_case in times.items():
        plain, tuned, domvs = (statistics.median(of_case[who]) for who in (*STYLES, "domvs"))
        rows.append({"case": case, "size": args.size, "order": args.order, "method": "hahn", "depth": "map",
                     "domvs_ms": domvs, "numpy_plain_ms": plain, "numpy_tuned_ms": tuned,
                     "times_faster_than_plain": plain / domvs, "times_faster_than_tuned": tuned / domvs,
                     "numpy": np.__version__, "rounds": args.rounds})
    if args.json:
        print("[\n  " + ",\n  ".join(map(json.dumps, rows)) + "\n]")
    else:
        for row in rows:
            print("{case:<7} {size} l = {order}: domvs {domvs_ms:.3f} ms; numpy plain {numpy_plain_ms:.3f} ms, "
                  "{times_faster_than_plain:.1f} times; tuned {numpy_tuned_ms:.3f} ms, "
                  "{times_faster_than_tuned:.1f} times".format(**row))
    return 0 if all(row["times_faster_than_plain"] >= args.at_least for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
