#!/usr/bin/env python3
"""Makes every mesh, image and list of instances of demo.pbrt: `python3 generate.py [NAME...]`.

An engineer's table with a model of a weir on it. Lengths are in decimetres of table; the model has
its origin in the middle of its plinth's top, x across, y to the back, z up; water flows towards -x.
"""

import math
import os
import sys

from craft import (Mesh, clamp, cross, fbm, hash01, lathe, lerp, mix, noise, normalize, octahedral,
                   ramp, ramp_palette, smooth, torus, write_exr, write_png)

HALF_X, HALF_Y = 5.5, 3.0
UP, DOWN = 2.3, 1.05  # water levels

# --- the land and the water ----------------------------------------------------------------------


def shore(x):
    return 1.0 + 0.3 * math.sin(0.55 * x + 0.6) + 0.1 * math.sin(1.7 * x)


def terrain(x, y):
    bed = 0.35 + 0.5 * smooth(-0.5, 2.5, x) + 0.1 * fbm(x * 0.9, y * 0.9, 3, 1)
    bank = 1.75 + 0.95 * smooth(-3.5, 2.0, x) + 0.2 * fbm(x * 0.7, y * 0.7, 4, 2)
    bank += 1.0 * math.exp(-((x - 3.4) ** 2 / 5.0 + (y - 2.9) ** 2 / 1.6))
    bank += 0.45 * math.exp(-((x + 4.4) ** 2 / 2.0 + (y - 3.0) ** 2 / 1.0))
    s = shore(x) + 0.15 * noise(x * 1.9, 3.5, 3)
    return lerp(bed, bank, smooth(s - 0.45, s + 0.8, y))


def weir(x):
    """Height of the weir's back: a round crest, a hollow face, a toe."""
    crest = 1.9 - 0.16 * smooth(0.7, 1.0, x) ** 2
    return 0.3 + (crest - 0.3) * smooth(-1.75, 0.5, x)


def water(x, y):
    falls = smooth(-1.5, -0.6, x) * (1 - smooth(0.1, 0.9, x))
    thick = lerp(0.15, 0.42, smooth(0.0, 1.3, x))
    strands = abs(noise(y * 3.2 + 0.25 * noise(x * 1.3, y * 2, 8), x * 0.7, 5)) + 0.5 * abs(noise(y * 7.5, x * 0.9, 6))
    sheet = min(weir(x) + thick, UP) - 0.075 * falls * strands
    sheet += 0.012 * fbm(x * 1.3, y * 1.3, 3, 7) * smooth(0.4, 1.4, x)
    calm = math.exp(-max(0.0, -1.9 - x) / 1.4)
    pool = DOWN + (0.014 + 0.05 * calm) * fbm(x * 2.1, y * 2.1, 3, 9)
    boil = math.exp(-(((x + 1.75 + 0.12 * noise(y * 1.1, 0.5, 10)) / 0.36) ** 2))
    pool += boil * (0.1 + 0.13 * noise(x * 4, y * 3.1, 11))
    return lerp(pool, sheet, smooth(-1.75, -1.1, x))


def slope_normal(f, x, y, e=0.01):
    return ((f(x - e, y) - f(x + e, y)) / (2 * e), (f(x, y - e) - f(x, y + e)) / (2 * e), 1.0)


def skirt(m, path, low, high, uv_scale=None):
    """A wall below a closed path of (x, y) corners, each side cut into steps."""
    for (x0, y0), (x1, y1), steps in path:
        def at(i, j):
            x, y = lerp(x0, x1, i / steps), lerp(y0, y1, i / steps)
            z = high(x, y) if j else low
            s = (x + y) * (uv_scale or 1.0)
            return (x, y, z), (y1 - y0, x0 - x1, 0.0), (s, z * (uv_scale or 1.0))
        m.grid(steps, 1, at, uvs=uv_scale is not None)


def make_land():
    m = Mesh()
    nx, ny = 120, 64

    def at(i, j):
        x, y = -HALF_X + 2 * HALF_X * i / nx, -HALF_Y + 2 * HALF_Y * j / ny
        return (x, y, terrain(x, y)), slope_normal(terrain, x, y), (i / nx, j / ny)

    m.grid(nx, ny, at)
    m.write("land.ply.gz")
    m = Mesh()
    a, b, c, d = (-HALF_X, -HALF_Y), (HALF_X, -HALF_Y), (HALF_X, HALF_Y), (-HALF_X, HALF_Y)
    skirt(m, [(a, b, nx), (b, c, ny), (c, d, nx), (d, a, ny)], 0.0, terrain, 0.25)
    m.write("cut.ply.gz")


def make_water():
    m = Mesh()
    x0, x1, y0, y1 = -HALF_X + 0.01, HALF_X - 0.01, -HALF_Y + 0.01, 2.0
    # Columns stand closest where the water falls.
    xs, x = [], x0
    while x < x1:
        xs.append(x)
        x += lerp(0.105, 0.042, smooth(-3.0, -1.9, x) * (1 - smooth(0.6, 1.6, x)))
    xs.append(x1)
    nx, ny = len(xs) - 1, 92

    def y_at(j):
        return lerp(y0, y1, j / ny)

    m.grid(nx, ny, lambda i, j: ((xs[i], y_at(j), water(xs[i], y_at(j))), slope_normal(water, xs[i], y_at(j)), None), uvs=False)

    def wall(points, n):
        # Top corners repeat those of the surface, so that the body is closed.
        m.grid(len(points) - 1, 1, lambda i, j: ((*points[i], water(*points[i]) if j else 0.1), n, None), uvs=False)

    wall([(x, y0) for x in xs], (0, -1, 0))
    wall([(x, y1) for x in reversed(xs)], (0, 1, 0))
    wall([(x1, y_at(j)) for j in range(ny + 1)], (1, 0, 0))
    wall([(x0, y_at(j)) for j in range(ny, -1, -1)], (-1, 0, 0))
    m.grid(1, 1, lambda i, j: (((x1, x0)[i], (y0, y1)[j], 0.1), (0, 0, -1), None), uvs=False)
    m.write("water.ply.gz")


def make_weir():
    """The weir's body as bilinear patches, in pbrt's text: back, faces, upstream wall."""
    xs = [1.0, 0.97, 0.9, 0.8] + [0.7 - 2.5 * i / 26 for i in range(27)]
    y0, y1 = -HALF_Y - 0.02, 2.0
    points, normals, uvs, indices = [], [], [], []
    out = open("weir.pbrt", "w")
    out.write("# The weir's body: made by generate.py.\n")

    def vertex(p, n, uv):
        points.append(p)
        normals.append(normalize(n))
        uvs.append(uv)
        return len(points) - 1

    def strip(rows):
        # Of ((p, n, uv), (p, n, uv)) pairs; a patch runs u across the pair and v along the strip.
        ids = [(vertex(*a), vertex(*b)) for a, b in rows]
        indices.extend((a0, b0, a1, b1) for (a0, b0), (a1, b1) in zip(ids, ids[1:]))

    length, rows = 0.0, []
    for i, x in enumerate(xs):
        if i:
            length += math.hypot(xs[i - 1] - x, weir(xs[i - 1]) - weir(x))
        slope = (weir(x + 0.01) - weir(x - 0.01)) / 0.02
        n = (-slope, 0, 1)
        rows.append((((x, y0, weir(x)), n, (y0 / 3, length / 3)), ((x, y1, weir(x)), n, (y1 / 3, length / 3))))
    def numbers(rows):
        return "\n".join("    " + " ".join(f"{c:.4g}" for c in r) for r in rows)

    def shape(material):
        out.write(f'NamedMaterial "{material}"\nShape "bilinearmesh"\n  "point3 P" [\n{numbers(points)} ]\n  "normal N" [\n{numbers(normals)} ]\n')
        out.write(f'  "point2 uv" [\n{numbers(uvs)} ]\n  "integer indices" [\n{numbers(indices)} ]\n')
        for part in (points, normals, uvs, indices):
            part.clear()

    strip([(b, a) for a, b in rows])
    shape("glaze")
    strip([(((x, y0, weir(x)), (0, -1, 0), (x / 3, weir(x) / 3)), ((x, y0, 0.0), (0, -1, 0), (x / 3, 0))) for x in xs])
    strip([(((1.0, y, 0.0), (1, 0, 0), (y / 3, 0)), ((1.0, y, weir(1.0)), (1, 0, 0), (y / 3, 0.6))) for y in (y0, y1)])
    shape("masonry")
    out.close()


# --- growing and lying things --------------------------------------------------------------------


def blade(m, p, q, side, bend=(0, 0, 0)):
    """A leaf from p to q: two triangles, `side` across at its broadest."""
    mid = tuple(lerp(a, b, 0.45) + c for a, b, c in zip(p, q, bend))
    a = m.vertex(p)
    b = m.vertex(tuple(x - y for x, y in zip(mid, side)))
    c = m.vertex(q)
    d = m.vertex(tuple(x + y for x, y in zip(mid, side)))
    m.faces.append((a, b, c, d))


def make_plants():
    m = Mesh()  # a fir one unit tall
    count = 1100
    for k in range(count):
        h = (k + 0.5) / count
        h = 0.1 + 0.9 * (1 - math.sqrt(1 - h))  # more of them below, where the fir is broad
        a = k * 2.399963
        layer = 0.5 + 0.5 * abs(((h * 9) % 1) * 2 - 1)
        r = 0.3 * (1 - h) ** 0.85 * (0.6 + 0.4 * layer) * (0.85 + 0.3 * hash01(k, 1)) + 0.012
        c, s = math.cos(a), math.sin(a)
        droop = 0.06 + 0.1 * (1 - h)
        p = (0.15 * r * c, 0.15 * r * s, h + 0.02)
        q = (r * c, r * s, h - droop * (0.7 + 0.6 * hash01(k, 2)))
        w = 0.018 + 0.016 * (1 - h)
        blade(m, p, q, (-s * w, c * w, 0), (0, 0, 0.012))
    m.write("fir.ply.gz")

    m = Mesh()  # the crown of a broad-leaved tree: leaves on five balls
    balls = [(0, 0, 0.68, 0.26), (0.17, 0.05, 0.55, 0.19), (-0.16, 0.08, 0.57, 0.19), (0.02, -0.17, 0.54, 0.18), (0.0, 0.13, 0.5, 0.18)]
    for k in range(1500):
        bx, by, bz, br = balls[k % 5]
        z = 1 - 2 * hash01(k, 3)
        a, s = 2 * math.pi * hash01(k, 4), math.sqrt(1 - z * z)
        n = (math.cos(a) * s, math.sin(a) * s, z)
        r = br * (0.8 + 0.25 * hash01(k, 5))
        p = (bx + n[0] * r, by + n[1] * r, bz + n[2] * r)
        if p[2] < 0.36:
            continue
        t = normalize(cross(n, (hash01(k, 6) - 0.5, hash01(k, 7) - 0.5, hash01(k, 8) - 0.5)))
        t = normalize(tuple(u + 0.7 * (hash01(k, 9 + i) - 0.5) for i, u in enumerate(t)))
        side = normalize(cross(n, t))
        q = tuple(u + 0.06 * v for u, v in zip(p, t))
        blade(m, p, q, tuple(0.02 * c for c in side))
    m.write("crown.ply.gz")

    m = Mesh()  # a tuft of grass, half a unit tall
    for k in range(18):
        a = 2.399963 * k
        lean = 0.1 + 0.28 * hash01(k, 20)
        c, s = math.cos(a), math.sin(a)
        root = (0.06 * c * hash01(k, 21), 0.06 * s * hash01(k, 21), -0.03)
        tip = (c * lean, s * lean, 0.3 + 0.25 * hash01(k, 22))
        blade(m, root, tip, (-s * 0.016, c * 0.016, 0), (-c * lean * 0.2, -s * lean * 0.2, 0.05))
    m.write("tuft.ply.gz")


def instance(name, p, size, turn, tilt=0.0):
    if isinstance(size, (int, float)):
        size = (size, size, size)
    place = f"Translate {p[0]:.2f} {p[1]:.2f} {p[2]:.2f} Rotate {turn * 360:.0f} 0 0 1"
    if tilt:
        place += f" Rotate {tilt:.0f} 1 0 0"
    return f'AttributeBegin {place} Scale {" ".join(f"{s:.2g}" for s in size)} ObjectInstance "{name}" AttributeEnd\n'


def near_building(x, y, margin=0.0):
    return -0.2 - margin < x < 1.5 + margin and y > 0.9 - margin


def make_instances():
    out = ["# Stones, plants and foam of the model: made by generate.py.\n"]

    def scatter(seed, tries, x0, x1, y0, y1):
        for k in range(tries):
            r = [hash01(seed, k, i) for i in range(6)]
            x, y = lerp(x0, x1, r[0]), lerp(y0, y1, r[1])
            yield x, y, terrain(x, y), r[2:]

    # Gravel of the bed and the shores; some boulders break the surface below the weir.
    for x, y, z, r in scatter(1, 330, -5.3, 5.3, -2.8, 1.7):
        size = 0.05 + 0.13 * r[0] ** 3
        if -1.9 < x < 1.1 or near_building(x, y):
            continue
        out.append(instance(f"stone{int(r[1] * 3)}", (x, y, z + 0.25 * size), (size * 1.25, size, size * 0.75), r[2]))
    for x, y, z, r in scatter(12, 22, -5.1, -2.2, -2.6, 1.5):
        size = 0.24 + 0.3 * r[0] ** 2
        out.append(instance(f"stone{int(r[1] * 3)}", (x, y, z + 0.45 * size), (size * 1.3, size, size * 0.85), r[2]))
    for x, y, z, r in scatter(3, 26, 1.5, 5.2, 0.9, 1.6):
        size = 0.12 + 0.2 * r[0] ** 2
        out.append(instance(f"stone{int(r[1] * 3)}", (x, y, z + 0.3 * size), (size * 1.3, size, size * 0.8), r[2]))

    # Firs on the hill, three autumn trees, grass wherever it is dry.
    autumn = [(-3.1, 2.1, 1.75, 0.1), (-4.55, 2.35, 2.0, 0.6), (-1.45, 2.35, 1.5, 0.35)]
    stood = [(x, y) for x, y, _, _ in autumn]
    for x, y, z, r in scatter(4, 400, -5.2, 5.2, 1.75, 2.85):
        wanted = 0.8 if x > 1.8 else 0.12
        if r[3] > wanted or near_building(x, y, 0.25) or z < 1.8 + 0.6 * smooth(0, 2, x):
            continue
        if any((x - a) ** 2 + (y - b) ** 2 < 0.16 for a, b in stood):
            continue
        stood.append((x, y))
        out.append(instance("fir", (x, y, z - 0.05), 1.0 + 0.75 * r[0], r[1]))
    for x, y, size, turn in autumn:
        out.append(instance("autumn", (x, y, terrain(x, y) - 0.05), size, turn))
    for x, y, z, r in scatter(5, 1500, -5.4, 5.4, 0.9, 2.95):
        level = UP if x > 0.5 else DOWN
        if z > level + 0.22 and not near_building(x, y):
            out.append(instance("tuft", (x, y, z), 0.25 + 0.35 * r[0], r[1]))

    # Foam where the falling water meets the pool, and white strands down its face.
    for k in range(130):
        r = [hash01(6, k, i) for i in range(5)]
        x, y = -1.78 + 0.42 * (r[0] + r[1] - 1), lerp(-2.9, 1.1, r[2])
        out.append(instance("foam", (x, y, water(x, y)), 0.7 + 0.6 * r[3], r[4]))
    for k in range(420):
        r = [hash01(7, k, i) for i in range(5)]
        x, y = lerp(-1.45, 0.2, r[0] ** 1.5), lerp(-2.92, 1.1, (k + r[1]) / 420)
        n = normalize(slope_normal(water, x, y))
        steep = math.degrees(math.atan2(n[0], n[2]))
        long = 0.06 + 0.14 * r[2]
        out.append(f'AttributeBegin Translate {x:.2f} {y:.2f} {water(x, y):.3f} Rotate {steep:.0f} 0 1 0 Scale {long:.2f} {0.006 + 0.008 * r[3]:.4f} 0.008 ObjectInstance "bubble" AttributeEnd\n')
    with open("instances.pbrt", "w") as f:
        f.writelines(out)

    with open("foam.pbrt", "w") as f:
        f.write("# A handful of foam to be instanced: made by generate.py.\n")
        f.write('ObjectBegin "foam"\n  NamedMaterial "foam"\n')
        for k in range(22):
            r = [hash01(8, k, i) for i in range(4)]
            x, y = 0.16 * (r[0] + hash01(8, k, 5) - 1), 0.16 * (r[1] + hash01(8, k, 6) - 1)
            f.write(f'  AttributeBegin Translate {x:.3f} {y:.3f} {0.012 * r[2]:.3f} Shape "sphere" "float radius" {0.006 + 0.022 * r[3] ** 2:.4f} AttributeEnd\n')
        f.write("ObjectEnd\n")

    # Control cages of three stones: knocked-about icosahedra, subdivided by the renderer.
    g = (1 + math.sqrt(5)) / 2
    corners = [normalize(p) for p in [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g), (0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]]
    faces = "0 11 5  0 5 1  0 1 7  0 7 10  0 10 11  1 5 9  5 11 4  11 10 2  10 7 6  7 1 8  3 9 4  3 4 2  3 2 6  3 6 8  3 8 9  4 9 5  2 4 11  6 2 10  8 6 7  9 8 1"
    with open("stones.pbrt", "w") as f:
        f.write("# Three stones to be instanced, about one unit in radius: made by generate.py.\n")
        for s in range(3):
            points = [" ".join(f"{c * (0.95 + 0.75 * hash01(30 + s, i)):.3f}" for c in p) for i, p in enumerate(corners)]
            f.write(f'ObjectBegin "stone{s}"\n  NamedMaterial "stone {s}"\n  Shape "loopsubdiv" "integer levels" 3\n')
            f.write(f'    "point3 P" [ {"  ".join(points)} ]\n    "integer indices" [ {faces} ]\nObjectEnd\n')


# --- the table's things --------------------------------------------------------------------------


def slab(half_x, half_y, height, corner, bevel):
    """A plate with round corners and a rounded upper edge, open below."""
    outline = []
    for q in range(4):
        cx, cy = (half_x - corner) * (1, -1, -1, 1)[q], (half_y - corner) * (1, 1, -1, -1)[q]
        for i in range(7):
            a = math.pi / 2 * (q + i / 6)
            outline.append((cx, cy, math.cos(a), math.sin(a)))
    profile = [(0.0, 0.0, 1.0, 0.0), (0.0, height - bevel, 1.0, 0.0)]
    profile += [(bevel * (1 - math.cos(a)), height - bevel * (1 - math.sin(a)), math.cos(a), math.sin(a)) for a in (math.pi / 2 * i / 6 for i in range(1, 7))]
    m = Mesh()
    n = len(outline)

    def at(i, j):
        cx, cy, c, s = outline[i % n]
        inset, z, across, up = profile[j]
        r = corner - inset
        return (cx + r * c, cy + r * s, z), (c * across, s * across, up), None

    m.grid(n, len(profile) - 1, at, uvs=False)
    top = [m.vertex(at(i, len(profile) - 1)[0], (0, 0, 1)) for i in range(n)]
    m.faces += [(top[0], top[i], top[i + 1]) for i in range(1, n - 1)]
    return m


def make_things():
    slab(6.2, 3.7, 0.9, 0.25, 0.1).write("plinth.ply.gz")
    torus(1.0, 0.1, 48, 12).write("ring.ply.gz")
    # A plumb bob: point below, a waist, a cap and an eye, three units tall.
    bob = [(0.0, 0.0), (0.03, 0.05), (0.05, 0.25), (0.06, 0.3), (0.34, 1.5), (0.38, 1.62), (0.4, 1.7), (0.4, 2.35), (0.38, 2.42), (0.3, 2.47),
           (0.17, 2.5), (0.15, 2.53), (0.15, 2.66), (0.17, 2.69), (0.24, 2.71), (0.26, 2.74), (0.26, 2.92), (0.24, 2.95), (0.1, 2.97), (0.07, 3.0), (0.07, 3.1), (0.0, 3.12)]
    lathe(bob, 48).write("bob.ply.gz")
    handle = [(0.0, 0.0), (0.1, 0.02), (0.13, 0.1), (0.12, 0.3), (0.1, 0.55), (0.13, 1.1), (0.16, 1.6), (0.15, 1.9), (0.1, 2.05), (0.0, 2.1)]
    lathe(handle, 24).write("handle.ply.gz")
    # The sheet of paper: flat on the table, one corner rolled up.
    m = Mesh()
    w, h = 6.4, 4.2

    def at(i, j):
        u, v = i / 40, j / 28
        x, y = u * w, v * h
        # Distance along the diagonal past the line where the paper leaves the table.
        d = 1.7 - ((w - x) * 0.8 + (h - y) * 0.6)
        lift, back = 0.0, 0.0
        if d > 0:
            r = 1.15
            lift, back = r * (1 - math.cos(d / r)), d - r * math.sin(d / r)
        wave = 0.012 * (1 + noise(x * 0.7, y * 0.7, 15))
        return (x - 0.8 * back, y - 0.6 * back, 0.012 + wave + lift), None, (u, v)

    def with_normal(i, j):
        p, _, uv = at(i, j)
        a, b = at(min(i + 1, 40), j)[0], at(max(i - 1, 0), j)[0]
        c, d = at(i, min(j + 1, 28))[0], at(i, max(j - 1, 0))[0]
        return p, cross(tuple(s - t for s, t in zip(a, b)), tuple(s - t for s, t in zip(c, d))), uv

    m.grid(40, 28, with_normal)
    m.write("paper.ply.gz")


# --- images --------------------------------------------------------------------------------------


def tile_noise(x, y, nx, ny, seed):
    """Value noise on [0, 1)² with nx · ny cells, repeating."""
    x, y = x * nx, y * ny
    i, j = math.floor(x), math.floor(y)
    u, v = x - i, y - j
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    at = lambda a, b: 2 * hash01(a % nx, b % ny, seed) - 1
    return lerp(lerp(at(i, j), at(i + 1, j), u), lerp(at(i, j + 1), at(i + 1, j + 1), u), v)


def indexed(path, w, h, value, stops, n=96):
    """A PNG of a number in [0, 1] per pixel, coloured by a ramp; rows run downwards."""
    rows = [[round(clamp(value((x + 0.5) / w, (y + 0.5) / h)) * (n - 1)) for x in range(w)] for y in range(h)]
    write_png(path, w, h, rows, ramp_palette(stops, n))


def make_wood():
    planks = 5

    def value(u, v):
        k = math.floor(v * planks)
        at = v * planks - k
        edge = min(at, 1 - at)
        shift = hash01(k, 40)
        u2 = (u + shift) % 1
        bend = 0.035 * tile_noise(u2, v, 3, 5, 41)
        rings = 0.5 + 0.5 * math.sin(2 * math.pi * (6 * (v + bend) * planks + 2.5 * tile_noise(u2, v, 2, 10, 42)))
        grain = tile_noise(u2, v + 0.3 * bend, 10, 160, 43) + 0.6 * tile_noise(u2, v, 24, 250, 44)
        t = 0.5 + 0.2 * (rings - 0.5) + 0.14 * grain + 0.22 * (hash01(k, 45) - 0.5) + 0.07 * tile_noise(u2, v, 4, 8, 46)
        return t * smooth(-0.004, 0.02, edge)

    indexed("wood.png", 640, 640, value, [(0, (26, 14, 8)), (0.35, (96, 56, 31)), (0.6, (146, 92, 54)), (1, (194, 138, 88))], 64)


def make_ground():
    w, h = 352, 192

    def value(u, v):
        x, y = lerp(-HALF_X, HALF_X, u), lerp(HALF_Y, -HALF_Y, v)
        z = terrain(x, y)
        level = water(x, min(y, 1.2))
        n = 0.6 * fbm(x * 2.2, y * 2.2, 4, 20, 0.65) + 0.25 * noise(x * 14, y * 14, 21)
        dry = smooth(level - 0.06, level + 0.14, z + 0.08 * n)
        wet = 0.22 + 0.3 * n
        return lerp(wet, 0.78 + 0.3 * n, dry)

    stops = [(0, (52, 124, 128)), (0.3, (112, 182, 174)), (0.45, (172, 190, 160)), (0.55, (170, 150, 106)), (0.64, (98, 104, 48)), (0.8, (84, 112, 40)), (1, (134, 150, 62))]
    indexed("ground.png", w, h, value, stops, 96)


def make_cut():
    """Strata; a turn of the pattern is four units wide and high."""

    def value(u, v):
        bend = 0.04 * tile_noise(u, v, 3, 2, 50)
        layer = tile_noise(u * 0.999, v + bend, 2, 26, 51) + 0.6 * tile_noise(u, v + bend, 3, 60, 52)
        speck = tile_noise(u, v, 90, 90, 53)
        return 0.5 + 0.32 * layer + 0.1 * speck

    indexed("strata.png", 256, 256, value, [(0, (52, 38, 30)), (0.4, (104, 76, 54)), (0.7, (150, 116, 84)), (1, (196, 168, 130))], 48)


def make_stone():
    """Masonry: courses of blocks, eight across and twelve up."""

    def value(u, v):
        row = math.floor(v * 12)
        a = (u * 8 + 0.5 * (row % 2)) % 8
        b = v * 12 - row
        col = math.floor(a)
        a -= col
        joint = min(min(a, 1 - a) * 1.6, min(b, 1 - b))
        t = 0.62 + 0.22 * (hash01(row, col, 60) - 0.5) + 0.1 * tile_noise(u, v, 40, 40, 61) + 0.1 * tile_noise(u, v, 9, 9, 62)
        return t * lerp(0.72, 1, smooth(0.03, 0.09, joint))

    indexed("stone.png", 256, 256, value, [(0, (70, 66, 62)), (0.5, (182, 168, 144)), (1, (236, 224, 200))], 64)


FONT = {  # strokes on a 4 by 6 grid, y up
    "W": ["06 10 24 30 46"], "E": ["40 00 06 46", "03 33"], "I": ["20 26"], "R": ["00 06 36 45 44 33 03", "23 40"],
    "S": ["01 10 30 41 42 33 13 04 05 16 36 45"], "C": ["45 36 16 05 01 10 30 41"], "T": ["06 46", "26 20"], "O": ["10 01 05 16 36 45 41 30 10"],
    "N": ["00 06 40 46"], "A": ["00 26 40", "12 32"], "-": ["13 33"], "1": ["15 26 20"], "2": ["05 16 36 45 44 00 40"], "5": ["46 06 03 33 42 41 30 10 01"],
    "0": ["10 01 05 16 36 45 41 30 10"], ":": ["21 22", "24 25"], "B": ["00 06 36 45 44 33 03", "33 42 41 30 00"], "L": ["06 00 40"], " ": [],
}


class Drawing:
    """Antialiased strokes on a grey page; pixels, y down."""

    def __init__(self, w, h):
        self.w, self.h = w, h
        self.ink = [[0.0] * w for _ in range(h)]

    def line(self, p, q, width=1.0, strength=1.0):
        (x0, y0), (x1, y1) = p, q
        r = width / 2 + 1
        dx, dy = x1 - x0, y1 - y0
        long2 = dx * dx + dy * dy or 1e-9
        for y in range(max(0, int(min(y0, y1) - r)), min(self.h, int(max(y0, y1) + r) + 2)):
            for x in range(max(0, int(min(x0, x1) - r)), min(self.w, int(max(x0, x1) + r) + 2)):
                px, py = x + 0.5 - x0, y + 0.5 - y0
                t = clamp((px * dx + py * dy) / long2)
                d = math.hypot(px - t * dx, py - t * dy)
                self.ink[y][x] = max(self.ink[y][x], strength * clamp(width / 2 + 0.5 - d))

    def path(self, points, width=1.0, strength=1.0):
        for p, q in zip(points, points[1:]):
            self.line(p, q, width, strength)

    def text(self, words, x, y, size, width=1.0, gap=1.5):
        for letter in words:
            for stroke in FONT[letter]:
                self.path([(x + int(c[0]) * size / 6, y - int(c[1]) * size / 6) for c in stroke.split()], width)
            x += (4 + gap) * size / 6


def make_drawings():
    d = Drawing(400, 96)
    d.text("WEIR", 64, 76, 56, 9, 4)
    frame = [(7, 7), (393, 7), (393, 89), (7, 89), (7, 7)]
    d.path(frame, 3)
    write_png("plaque.png", d.w, d.h, [[round(255 * v) for v in row] for row in d.ink])

    d = Drawing(768, 504)
    sx = lambda x: 400 + x * 60
    sz = lambda z: 330 - z * 60
    d.path([(14, 14), (754, 14), (754, 490), (14, 490), (14, 14)], 2.5)
    d.path([(20, 20), (748, 20), (748, 484), (20, 484), (20, 20)], 1)
    for i in range(1, 19):
        d.line((14 + i * 40, 20), (14 + i * 40, 484), 1, 0.13)
    for i in range(1, 12):
        d.line((20, 14 + i * 40), (748, 14 + i * 40), 1, 0.13)
    xs = [-1.75 + 2.75 * i / 60 for i in range(61)]
    d.path([(sx(x), sz(weir(x))) for x in xs] + [(sx(1.0), sz(0)), (sx(-1.75), sz(0)), (sx(-1.75), sz(0.3))], 3)
    for i in range(26):  # hatching of the cut
        x = -1.7 + i * 0.1
        z = 0.0
        points = []
        while x < 1.0 and z < weir(x):
            points.append((sx(x), sz(z)))
            x, z = x + 0.04, z + 0.04
        if len(points) > 1:
            d.line(points[0], points[-1], 1, 0.6)
    ws = [-5.4 + 10.8 * i / 150 for i in range(151)]
    d.path([(sx(x), sz(water(x, -0.4))) for x in ws], 2)
    bed = [(sx(x), sz(terrain(x, -1) if not -1.75 < x < 1 else 0)) for x in ws]
    d.path(bed, 1.6, 0.8)
    for x, z0, z1 in [(2.6, 0.85, UP), (-3.6, 0.35, DOWN), (1.6, 0.0, 1.9)]:
        d.line((sx(x), sz(z0)), (sx(x), sz(z1)), 1)
        for z, s in ((z0, -1), (z1, 1)):
            d.path([(sx(x) - 4, sz(z) + 9 * s), (sx(x), sz(z)), (sx(x) + 4, sz(z) + 9 * s)], 1.2)
    d.line((sx(0.7), sz(1.9)), (sx(1.75), sz(1.9)), 1)
    d.line((sx(-1.75), sz(-0.6)), (sx(1.0), sz(-0.6)), 1)
    for x, s in ((-1.75, 1), (1.0, -1)):
        d.path([(sx(x) + 9 * s, sz(-0.6) - 4), (sx(x), sz(-0.6)), (sx(x) + 9 * s, sz(-0.6) + 4)], 1.2)
        d.line((sx(x), sz(-0.1)), (sx(x), sz(-0.75)), 1)
    d.text("2 5", sx(-0.6), sz(-0.75) + 18, 13, 1.3)
    d.text("WEIR", 52, 84, 40, 3.6, 2)
    d.text("SECTION A-A", 54, 122, 16, 1.5)
    d.path([(560, 484), (560, 430), (748, 430)], 1.5)
    d.text("SCALE 1:20", 574, 466, 20, 1.6)
    rows = []
    for y in range(d.h):
        row = []
        for x in range(d.w):
            paper = 0.16 + 0.12 * noise(x / 90, y / 90, 30)
            row.append(round(23 * max(0.95 * d.ink[y][x], clamp(paper + 0.5 * d.ink[y][x]))))
        rows.append(row)
    write_png("blueprint.png", d.w, d.h, rows, ramp_palette([(0, (14, 44, 96)), (0.3, (30, 72, 134)), (1, (232, 240, 246))], 24))


# --- the sky -------------------------------------------------------------------------------------

SUN = normalize((-0.6, 0.48, 0.58))


def sky(d):
    """Linear radiance from a direction: evening sky, a soft sun, hills and a lake in the haze."""
    azimuth, height = math.atan2(d[0], d[1]), math.degrees(math.asin(clamp(d[2], -1, 1)))
    to_sun = math.acos(clamp(sum(a * b for a, b in zip(d, SUN)), -1, 1))
    warm = math.exp(-((to_sun / 0.9) ** 2))
    c = ramp([(0, (1.25, 0.85, 0.56)), (2, (1.0, 0.8, 0.7)), (5, (0.5, 0.6, 0.84)), (20, (0.3, 0.47, 0.82)), (90, (0.2, 0.36, 0.72))], max(height, 0))
    c = mix(c, (1.5, 1.1, 0.72), 0.55 * warm)
    if height > -2:
        # Clouds lie on a plane above: they shrink towards the horizon.
        s = 1 / (d[2] + 0.14)
        n = fbm(d[0] * s * 0.9 + 3, d[1] * s * 1.5, 5, 40, 0.55)
        cover = smooth(0.08, 0.5, n + 0.02) * smooth(0.5, 4, height)
        c = mix(c, mix((1.12, 0.96, 0.9), (1.8, 1.4, 1.0), warm), 0.8 * cover)
    # Broad, so that what lies under water, where no shadow ray reaches, finds it by chance.
    core = 3.6 * math.exp(-((to_sun / 0.46) ** 2))
    c = tuple(a + core * b for a, b in zip(c, (1.0, 0.84, 0.62)))
    x, y = math.sin(azimuth), math.cos(azimuth)
    # The lake mirrors the evening; hills stand beyond it, each range nearer, lower and darker.
    if height < 0:
        lake = ramp([(0, (0.8, 0.68, 0.6)), (4, (0.5, 0.55, 0.62)), (9, (0.3, 0.38, 0.47)), (16, (0.24, 0.3, 0.36)), (30, (0.17, 0.15, 0.13)), (90, (0.14, 0.12, 0.1))], -height)
        lake = tuple(v * (1 + 0.12 * noise(azimuth * 9, height * 1.6, 60)) for v in lake)
        c = lake
    # Their edges are wider than two texels: a map is read without interpolation.
    for k, (top, rough, foot, colour, haze) in enumerate(HILLS):
        ridge = top + rough * fbm(3.4 * (1 + k) * x + 9, 3.4 * (1 + k) * y, 3, 50 + k)
        inside = smooth(-1.1, 1.1, ridge - height) * smooth(foot - 0.9, foot + 0.9, height)
        c = mix(c, mix(colour, haze, 0.75 * smooth(0, 4.5, ridge - height)), inside)
    return c


# Height of the ridge, its roughness, the foot (all in degrees), colour, haze before it.
HILLS = [
    (2.0, 2.8, -2.5, (0.56, 0.56, 0.7), (0.98, 0.83, 0.72)),
    (-0.2, 2.2, -3.2, (0.26, 0.34, 0.46), (0.74, 0.68, 0.66)),
    (-2.6, 2.4, -4.6, (0.09, 0.15, 0.14), (0.34, 0.36, 0.34)),
]


def make_sky():
    n = 512
    write_exr("sky.exr", n, n, lambda x, y: sky(octahedral((x + 0.5) / n, (y + 0.5) / n)))


MAKERS = {"land": make_land, "water": make_water, "weir": make_weir, "plants": make_plants, "instances": make_instances,
          "things": make_things, "wood": make_wood, "ground": make_ground, "cut": make_cut, "stone": make_stone,
          "drawings": make_drawings, "sky": make_sky}

if __name__ == "__main__":
    os.chdir(os.path.dirname(os.path.abspath(__file__)))
    for name in sys.argv[1:] or MAKERS:
        MAKERS[name]()
