"""What generate.py makes things with: noise, meshes, and writers of PNG, OpenEXR and PLY.

Standard library only. Deterministic: the same Python source gives the same bytes for the same zlib.
"""

import gzip
import math
import struct
import zlib

# --- numbers -------------------------------------------------------------------------------------


def hash01(*keys):
    """A number in [0, 1) that depends on whole numbers alone."""
    h = 0x9E3779B9
    for k in keys:
        h ^= (k * 0x85EBCA6B) & 0xFFFFFFFF
        h = (h ^ (h >> 15)) * 0x2C1B3C6D & 0xFFFFFFFF
        h = (h ^ (h >> 12)) * 0x297A2D39 & 0xFFFFFFFF
        h ^= h >> 15
    return h / 4294967296.0


TABLE = [2.0 * hash01(i, 77) - 1.0 for i in range(4096)]


def noise(x, y, z=0):
    """Smooth value noise in [-1, 1]; `z` (a whole number) chooses an independent one."""
    i, j = math.floor(x), math.floor(y)
    u, v = x - i, y - j
    u, v = u * u * u * (u * (u * 6 - 15) + 10), v * v * v * (v * (v * 6 - 15) + 10)
    p = i * 374761393 + z * 1013904223
    q0, q1 = j * 668265263, (j + 1) * 668265263

    def at(a, b):
        h = (a + b) & 0xFFFFFFFF
        h = (h ^ (h >> 13)) * 1274126177 & 0xFFFFFFFF
        return TABLE[(h ^ (h >> 16)) & 4095]

    p1 = p + 374761393
    a, b, c, d = at(p, q0), at(p1, q0), at(p, q1), at(p1, q1)
    return (a + (b - a) * u) * (1 - v) + (c + (d - c) * u) * v


def fbm(x, y, octaves, z=0, gain=0.5):
    """Octaves of `noise`, within about [-1, 1]."""
    total, weight, norm = 0.0, 1.0, 0.0
    for o in range(octaves):
        total += weight * noise(x, y, z * 16 + o)
        norm += weight
        weight *= gain
        x, y = x * 2.03 + 17.1, y * 2.03 - 5.7
    return total / norm


def clamp(x, lo=0.0, hi=1.0):
    return lo if x < lo else hi if x > hi else x


def smooth(lo, hi, x):
    t = clamp((x - lo) / (hi - lo))
    return t * t * (3.0 - 2.0 * t)


def lerp(a, b, t):
    return a + (b - a) * t


def mix(a, b, t):
    return tuple(lerp(p, q, t) for p, q in zip(a, b))


def ramp(stops, t):
    """Colour of `t` on [(t, colour), ...] in ascending order."""
    for (t0, c0), (t1, c1) in zip(stops, stops[1:]):
        if t <= t1:
            return mix(c0, c1, clamp((t - t0) / (t1 - t0)))
    return stops[-1][1]


def normalize(v):
    n = math.sqrt(sum(c * c for c in v)) or 1.0
    return tuple(c / n for c in v)


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


# --- images --------------------------------------------------------------------------------------


def write_png(path, width, height, rows, palette=None):
    """8-bit PNG of `rows` (bytes each): grey, or indices into a `palette` of (r, g, b)."""

    def chunk(kind, data):
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    kind = 3 if palette else 0
    raw = b"".join(b"\0" + bytes(row) for row in rows)
    with open(path, "wb") as f:
        f.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0)))
        if palette:
            f.write(chunk(b"PLTE", b"".join(bytes(c) for c in palette)))
        f.write(chunk(b"IDAT", zlib.compress(raw, 9)) + chunk(b"IEND", b""))


def ramp_palette(stops, n):
    """`n` sRGB colours along a ramp."""
    return [tuple(round(c) for c in ramp(stops, i / (n - 1))) for i in range(n)]


def write_exr(path, width, height, pixel):
    """Half-float RGB OpenEXR, ZIP blocks of 16 lines; `pixel(x, y)` gives linear (r, g, b)."""

    def attribute(name, kind, data):
        return name + b"\0" + kind + b"\0" + struct.pack("<i", len(data)) + data

    channels = b"".join(c + b"\0" + struct.pack("<iBxxxii", 1, 0, 1, 1) for c in (b"B", b"G", b"R")) + b"\0"
    box = struct.pack("<iiii", 0, 0, width - 1, height - 1)
    header = b"\x76\x2f\x31\x01" + struct.pack("<I", 2)
    header += attribute(b"channels", b"chlist", channels)
    header += attribute(b"compression", b"compression", b"\3")
    header += attribute(b"dataWindow", b"box2i", box) + attribute(b"displayWindow", b"box2i", box)
    header += attribute(b"lineOrder", b"lineOrder", b"\0")
    header += attribute(b"pixelAspectRatio", b"float", struct.pack("<f", 1))
    header += attribute(b"screenWindowCenter", b"v2f", struct.pack("<ff", 0, 0))
    header += attribute(b"screenWindowWidth", b"float", struct.pack("<f", 1)) + b"\0"
    blocks = []
    for y0 in range(0, height, 16):
        raw = b""
        for y in range(y0, min(y0 + 16, height)):
            line = [pixel(x, y) for x in range(width)]
            for c in (2, 1, 0):
                # Seven bits of mantissa are plenty for a sky, and pack better.
                raw += b"".join(struct.pack("<H", half(p[c]) & 0xFFF8) for p in line)
        mixed = raw[0::2] + raw[1::2]
        delta = bytes([mixed[0]]) + bytes((b - a + 128) & 255 for a, b in zip(mixed, mixed[1:]))
        packed = zlib.compress(delta, 9)
        data = packed if len(packed) < len(raw) else raw
        blocks.append(struct.pack("<ii", y0, len(data)) + data)
    offset = len(header) + 8 * len(blocks)
    table = b""
    for b in blocks:
        table += struct.pack("<Q", offset)
        offset += len(b)
    with open(path, "wb") as f:
        f.write(header + table + b"".join(blocks))


def half(x):
    return struct.unpack("<H", struct.pack("<e", x))[0]


def octahedral(u, v):
    """Direction of a point of the unit square under the equal-area octahedral map (Clarberg 2008)."""
    x, y = 2 * u - 1, 2 * v - 1
    a, b = abs(x), abs(y)
    d = 1 - (a + b)
    r = 1 - abs(d)
    phi = math.pi / 4 * ((b - a) / r + 1 if r else 1)
    z = math.copysign(1 - r * r, d)
    s = r * math.sqrt(max(0.0, 2 - r * r))
    return (math.copysign(math.cos(phi) * s, x), math.copysign(math.sin(phi) * s, y), z)


# --- meshes --------------------------------------------------------------------------------------


class Mesh:
    """Vertices (position, normal or None, uv or None) and faces of three or four of them."""

    def __init__(self):
        self.points, self.normals, self.uvs, self.faces = [], [], [], []

    def vertex(self, p, n=None, uv=None):
        self.points.append(p)
        if n is not None:
            self.normals.append(normalize(n))
        if uv is not None:
            self.uvs.append(uv)
        return len(self.points) - 1

    def grid(self, nu, nv, at, normals=True, uvs=True):
        """`at(i, j)` gives (position, normal, uv); (nu + 1) · (nv + 1) vertices, nu · nv faces."""
        first = len(self.points)
        for j in range(nv + 1):
            for i in range(nu + 1):
                p, n, uv = at(i, j)
                self.vertex(p, n if normals else None, uv if uvs else None)
        for j in range(nv):
            for i in range(nu):
                a = first + j * (nu + 1) + i
                self.faces.append((a, a + 1, a + nu + 2, a + nu + 1))

    def write(self, path):
        """Binary little-endian PLY, gzipped. Coordinates are rounded so that they pack well."""
        lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(self.points)}"]
        names = ["x", "y", "z"] + (["nx", "ny", "nz"] if self.normals else []) + (["u", "v"] if self.uvs else [])
        lines += [f"property float {n}" for n in names]
        lines += [f"element face {len(self.faces)}", "property list uchar int vertex_indices", "end_header", ""]
        columns = [[[round(c * 4096) / 4096 for c in p] for p in self.points]]
        if self.normals:
            columns.append([[round(c * 1024) / 1024 for c in n] for n in self.normals])
        if self.uvs:
            columns.append([[round(c * 4096) / 4096 for c in t] for t in self.uvs])
        body = b"".join(struct.pack(f"<{len(names)}f", *(c for part in row for c in part)) for row in zip(*columns))
        body += b"".join(struct.pack(f"<B{len(f)}i", len(f), *f) for f in self.faces)
        with open(path, "wb") as out, gzip.GzipFile(filename="", mode="wb", fileobj=out, compresslevel=9, mtime=0) as f:
            f.write("\n".join(lines).encode() + body)


def lathe(profile, n, closed=False):
    """Turns (radius, z) points about z; smooth, outside to the right of the profile's direction upwards."""
    m = Mesh()
    k = len(profile)

    def at(i, j):
        r, z = profile[j % k]
        (r0, z0), (r1, z1) = profile[(j - 1) % k if closed or j else 0], profile[(j + 1) % k if closed or j + 1 < k else k - 1]
        c, s = math.cos(2 * math.pi * i / n), math.sin(2 * math.pi * i / n)
        dr, dz = r1 - r0, z1 - z0
        return (r * c, r * s, z), (dz * c, dz * s, -dr), (i / n, j / k)

    m.grid(n, k if closed else k - 1, at, uvs=False)
    return m


def torus(big, small, n, k):
    """A ring about z."""
    turn = [2 * math.pi * i / k for i in range(k)]
    return lathe([(big + small * math.cos(a), small * math.sin(a)) for a in turn], n, closed=True)
