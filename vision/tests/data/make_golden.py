"""Makes golden.json: what the tests hold the crate to, from the definitions alone, at 200 (polynomials) or 60 digits.

Nothing here shares a formula with the crate's fast way: polynomials are the hypergeometric closed forms times the square root of
the weight, sums are the literal double sums over pixels, and the step is an LU solve. Run: python3 make_golden.py > golden.json
"""

import json
from mpmath import mp, mpf, binomial, cos, exp, eigsy, log, lu_solve, matrix, pi, sqrt

mp.dps = 200


def closed_form(top, bottom, argument, n):
    """sum_k (top_1)_k ... / (bottom_1)_k ... argument^k / k!, up to k = n."""
    total, term = mpf(0), mpf(1)
    for k in range(n + 1):
        total += term
        for a in top:
            term *= a + k
        for b in bottom:
            term /= b + k if b + k != 0 else 1
        term *= argument / (k + 1)
    return total


def rows(kind, points, degrees, a=None, b=None, p=None):
    """Orthonormal rows on `points` points, highest coefficient positive."""
    last = points - 1
    if kind == "cosine":
        angle = lambda n, u: pi * n * (2 * u + 1) / (2 * mpf(points))
        return [[sqrt(mpf(1 if n == 0 else 2) / points) * cos(angle(n, u)) for u in range(points)] for n in degrees]
    if kind == "krawtchouk":
        p = mpf(p)
        weight = [binomial(last, u) * p**u * (1 - p) ** (last - u) for u in range(points)]
        value = lambda n, u: closed_form([-n, -u], [-last], 1 / p, n)
    else:
        a, b = (mpf(a), mpf(b)) if kind == "hahn" else (mpf(0), mpf(0))
        weight = [mpf(1)]
        for u in range(1, points):
            weight.append(weight[-1] * (b + u) / u * (points - u) / (points + a - u))
        value = lambda n, u: closed_form([-n, n + a + b + 1, -u], [b + 1, -last], mpf(1), n)
    made = []
    for n in degrees:
        row = [(-1) ** n * value(n, u) * sqrt(w) for u, w in enumerate(weight)]
        length = sqrt(sum(x * x for x in row))
        made.append([x / length for x in row])
    return made


POLYNOMIALS = [
    dict(kind="hahn", length=100, a=3.25, b=0.5, n=[0, 1, 7, 20, 40], u=[0, 9, 41, 77, 99]),
    dict(kind="hahn", length=333, a=8.0, b=8.0, n=[0, 3, 16, 40], u=[1, 100, 166, 290, 332]),
    dict(kind="hahn", length=720, a=150.0, b=1900.0, n=[0, 10, 18], u=[600, 655, 690]),
    dict(kind="hahn", length=1000, a=100000.0, b=90000.0, n=[0, 12, 33], u=[420, 474, 520]),
    dict(kind="hahn", length=1280, a=10.0, b=100000.0, n=[0, 9, 40], u=[1200, 1265, 1279]),
    dict(kind="tchebichef", length=8, n=[0, 1, 7], u=[0, 3, 7]),
    dict(kind="tchebichef", length=43, n=[2, 40], u=[0, 20, 42]),
    dict(kind="tchebichef", length=4096, n=[0, 5, 40], u=[0, 17, 2048, 4095]),
    dict(kind="krawtchouk", lattice="paper", length=200, p=0.37, n=[0, 2, 11, 40], u=[20, 70, 75, 110]),
    dict(kind="krawtchouk", lattice="paper", length=100, p=0.98, n=[0, 1, 6], u=[90, 97, 99]),
    dict(kind="krawtchouk", lattice="exact", length=512, p=0.999, n=[0, 4, 20], u=[480, 505, 511]),
    dict(kind="krawtchouk", lattice="exact", length=480, p=0.001, n=[0, 5, 12], u=[0, 2, 30]),
    dict(kind="krawtchouk", lattice="exact", length=1920, p=0.62, n=[0, 16, 40], u=[1150, 1190, 1240]),
    dict(kind="cosine", length=50, n=[0, 1, 13, 40], u=[0, 24, 49]),
]


def polynomial_case(case):
    extra = 1 if case.get("lattice") == "paper" else 0
    numbers = {k: case[k] for k in ("a", "b", "p") if k in case}
    made = rows(case["kind"], case["length"] + extra, case["n"], **numbers)
    return dict(case, values=[[float(row[u]) for u in case["u"]] for row in made])


# I(u, v) = h / (1 + ((u - cu)/ru)^2 + ((v - cv)/rv)^2) + k cos(wu u + wv v)^2, Z(u, v) = z0 + z1 u v/(W H) + z2 v/H metres.
def image(size, parameters):
    h, cu, cv, ru, rv, k, wu, wv = map(mpf, parameters)
    spot = lambda u, v: h / (1 + ((u - cu) / ru) ** 2 + ((v - cv) / rv) ** 2)
    return [[spot(u, v) + k * cos(wu * u + wv * v) ** 2 for u in range(size[0])] for v in range(size[1])]


def depth(size, parameters):
    z0, z1, z2 = map(mpf, parameters)
    return [[z0 + z1 * u * v / (size[0] * size[1]) + z2 * v / size[1] for u in range(size[0])] for v in range(size[1])]


def half_away(x):
    return int(mp.floor(x + mpf(1) / 2))


def sums(plane):
    return [sum(row[u] for row in plane) for u in range(len(plane[0]))], [sum(row) for row in plane]


def centroid(sums_of_axis):
    return sum(i * s for i, s in enumerate(sums_of_axis)) / sum(sums_of_axis)


def dispersion(sums_of_axis, center):
    total = sum(sums_of_axis)
    at = lambda i: sums_of_axis[i] / total if 0 <= i < len(sums_of_axis) else 0
    d, held = 0, at(center)
    while not held > mpf(0.9973):
        d += 1
        held += at(center + d) + at(center - d)
    return d


def window(current, desired):
    """Per axis: p on both lattices, and a, b by both rules."""
    found = []
    for own, wanted in zip(sums(current), sums(desired)):
        length = len(own)
        center = (centroid(own) + centroid(wanted)) / 2
        p = center / length
        spread = [dispersion(s, half_away(center)) for s in (own, wanted)]
        three_sigma = 3 * sqrt(length * p * (1 - p))

        def total(most, d):
            kappa = (log(mpf("0.01")) - log(mpf(most))) / (length - 1 - three_sigma)
            return exp(kappa * d + log(mpf("0.01")) - kappa * (length - 1))

        logs = sum(total(20 * (length - 1), d) for d in spread) / 2
        paper = total(20 * length, mpf(sum(spread)) / 2)
        found.append(dict(p_paper=p, p_exact=center / (length - 1), logs=[(1 - p) * logs, p * logs], paper=[(1 - p) * paper, p * paper]))
    return found


def mean_square(current, desired):
    pixels = [(a - b) ** 2 for x, y in zip(current, desired) for a, b in zip(x, y)]
    return sum(pixels) / len(pixels)


def gradient(values, i):
    last = len(values) - 1
    low, high = max(i - 1, 0), min(i + 1, last)
    return (values[high] - values[low]) / (high - low)


def interaction_planes(plane, metres, camera):
    """L_I, six numbers per pixel."""
    fu, fv, cu, cv = map(mpf, camera)
    made = []
    for v, row in enumerate(plane):
        made.append([])
        for u in range(len(row)):
            x, y, z = (u - cu) / fu, (v - cv) / fv, metres[v][u]
            gu, gv = fu * gradient(row, u), fv * gradient([r[u] for r in plane], v)
            lx = [-1 / z, 0, x / z, x * y, -(1 + x * x), y]
            ly = [0, -1 / z, y / z, 1 + y * y, -x * y, -x]
            made[-1].append([-(gu * i + gv * j) for i, j in zip(lx, ly)])
    return made


SCENES = [
    dict(
        size=[23, 17], camera=[19.0, 21.5, 10.5, 8.25], order=5,
        current=[0.7, 12.5, 7.0, 4.0, 5.0, 0.2, 0.31, 0.17], desired=[0.72, 10.0, 8.5, 4.5, 4.75, 0.2, 0.3, 0.2],
        depth_current=[0.9, 0.0, 0.0], depth_desired=[1.1, 0.0, 0.0],
    ),
    dict(
        size=[18, 24], camera=[22.0, 20.0, 9.0, 11.0], order=4,
        current=[0.6, 8.0, 13.0, 3.5, 5.0, 0.25, 0.2, 0.4], desired=[0.65, 9.5, 11.0, 3.0, 5.5, 0.25, 0.25, 0.35],
        depth_current=[0.8, 0.3, -0.2], depth_desired=[0.7, 0.1, 0.25],
    ),
]


def scene_case(scene):
    size, order = scene["size"], scene["order"]
    current, desired = image(size, scene["current"]), image(size, scene["desired"])
    views = [(current, depth(size, scene["depth_current"])), (desired, depth(size, scene["depth_desired"]))]
    own, wanted = [interaction_planes(i, z, scene["camera"]) for i, z in views]
    axes = window(current, desired)
    ab = [[half_away(x) for x in axis["logs"]] for axis in axes]
    choices = [
        ("hahn", [dict(a=a, b=b) for a, b in ab], 0),
        ("krawtchouk_paper", [dict(p=axis["p_paper"]) for axis in axes], 1),
        ("krawtchouk_exact", [dict(p=axis["p_exact"]) for axis in axes], 0),
        ("tchebichef", [{}, {}], 0),
        ("cosine", [{}, {}], 0),
    ]
    results = []
    for name, numbers, extra in choices:
        kind = name.split("_")[0]
        pu, qv = [rows(kind, side + extra, range(order + 1), **n) for side, n in zip(size, numbers)]
        e, rows_of_l = [], []
        for n in range(order + 1):
            for m in range(order + 1 - n):
                total = [mpf(0)] * 7
                for v in range(size[1]):
                    for u in range(size[0]):
                        weight = pu[n][u] * qv[m][v]
                        total[0] += weight * (current[v][u] - desired[v][u])
                        for k in range(6):
                            total[k + 1] += weight * (own[v][u][k] + wanted[v][u][k]) / 2
                e.append(total[0])
                rows_of_l.append(total[1:])
        l, right = matrix(rows_of_l), matrix(e)
        normal = l.T * l
        step = -lu_solve(normal, l.T * right)
        eigenvalues = eigsy(normal, eigvals_only=True)
        results.append(dict(
            method=name, gauss_newton=[float(s) for s in step], feature_error_squared=float(sum(x * x for x in e)),
            condition_number=float(sqrt(max(eigenvalues) / min(eigenvalues))), e=[float(x) for x in e],
        ))
    floats = [{k: [float(x) for x in v] if isinstance(v, list) else float(v) for k, v in axis.items()} for axis in axes]
    return dict(scene, pixel_mse=float(mean_square(current, desired)), window=floats, results=results)


WINDOWS = [
    dict(size=[120, 90], current=[0.8, 70.0, 30.0, 3.0, 2.0, 0.0, 0.1, 0.1], desired=[0.8, 61.0, 38.0, 2.5, 3.0, 0.0, 0.1, 0.1]),
    dict(size=[75, 75], current=[0.3, 20.0, 50.0, 9.0, 12.0, 0.1, 0.05, 0.2], desired=[0.3, 33.0, 45.0, 10.0, 8.0, 0.1, 0.06, 0.2]),
]

ORDERS = [(0.07, 0.07, 1e-3, 4, 16), (0.02, 0.07, 1e-3, 4, 16), (0.004, 0.09, 2e-3, 6, 19), (0.0021, 0.09, 2e-3, 3, 12), (0.2, 0.05, 1e-3, 4, 8)]


def order_case(mse, initial, epsilon, low, high):
    e, e0, eps = mpf(mse), mpf(initial), mpf(epsilon)
    eta = 1 / (1 + e / eps * (e - eps) / (e0 - eps))
    exact = (high - low) * eta + low
    return dict(mse=mse, initial_mse=initial, epsilon=epsilon, min=low, max=high, unrounded=float(exact), order=half_away(exact))


polynomials = [polynomial_case(case) for case in POLYNOMIALS]
mp.dps = 60
windows = []
for case in WINDOWS:
    axes = window(image(case["size"], case["current"]), image(case["size"], case["desired"]))
    windows.append(dict(case, window=[{k: [float(x) for x in v] if isinstance(v, list) else float(v) for k, v in a.items()} for a in axes]))
scenes = [scene_case(scene) for scene in SCENES]
orders = [order_case(*case) for case in ORDERS]
print(json.dumps(dict(polynomials=polynomials, windows=windows, orders=orders, scenes=scenes), separators=(",", ":")))
