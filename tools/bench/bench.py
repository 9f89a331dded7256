#!/usr/bin/env python3
"""Weir against other renderers and bare Embree: runs by turns, ratios by round. `tools/bench.sh` starts it and
says what may be set.

Invariant: a ratio's two sides ran in the same round, on 2 threads, with the same samples per pixel; a table
shows the median of the rounds' ratios, and their range.
Never: renders itself, or reads results of an earlier run."""

import json
import os
import re
import shlex
import statistics
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve()
ROOT = Path(os.environ["PEERS_ROOT"])
SCRIPTS = Path(os.environ["PEERS_SCRIPTS"])
OUT = ROOT / "out"
ROUNDS = int(os.environ.get("ROUNDS", "3"))
SPP = int(os.environ.get("SPP", "16"))
SCENES = os.environ.get("SCENES", "a b").split()
QUICK = os.environ.get("QUICK", "") not in ("", "0")
WAIT = os.environ.get("WAIT", "60")
EMBREE_SECONDS = os.environ.get("SEC", "1")
THREADS = 2
# One side of the square images, and scattering events of a path of 8 edges.
SIZE, DEPTH = 512, 7

MESHES = {
    "a": "white left right blob glass mirror light".split(),
    "b": "ter0 ter1 ter2 ter3".split(),
}
# Surfaces that emit: there Weir tries a path's last edge against them alone, far cheaper than a ray.
HAS_EMITTERS = {"a": True, "b": False}
# ebench.c has scene a's camera and light in it; these are scene b's. Each must occur exactly once.
EBENCH_B = [
    ("34.5f*M_PI", "42.f*M_PI"),
    ("{0,1,4.2f,sx*l,sy*l,-l,1e30f}",
     "{0,7.5f,15.5f,sx*l,(.88628f*sy-.46315f)*l,(-.46315f*sy-.88628f)*l,1e30f}"),
    ("lx=(rnd()*2-1)*.3f-r.ox,ly=2-r.oy,lz=(rnd()*2-1)*.3f-r.oz", "lx=-.45f,ly=.62f,lz=.35f"),
    ("{r.ox,r.oy,r.oz,lx,ly,lz,.9999f}", "{r.ox,r.oy,r.oz,lx,ly,lz,1e30f}"),
]
# Kinds of rays that nobody asks for here only cost time. Shuffled bounces are no part of the share: they show
# what order is worth.
EBENCH_KEEP = {"intersect1 primary coherent": "primary", "intersect1 bounce path-order": "bounce",
               "intersect1 bounce shuffled": "shuffled", "occluded1 shadow path-order": "shadow"}

NAMES = {
    "weir": "Weir",
    "mitsuba-llvm_ad_rgb": "Mitsuba LLVM",
    "mitsuba-scalar_rgb": "Mitsuba scalar",
    "cycles": "Cycles",
    "luxcore": "LuxCore",
    "multijitter": "Mitsuba LLVM, multijitter",
}
BASE = "mitsuba-llvm_ad_rgb"


# --- One run each, started through the scripts' bench.py, which waits for quiet and keeps the record. ---


def run_weir(weir, scene, spp, seed, depth, out):
    """Renders, and prints the JSON line that the other renderers' scripts print."""
    stats_file = Path(out).with_suffix(".json")
    subprocess.run(
        [weir, "render", ROOT / "scenes" / scene / "scene.pbrt", "-q", "-o", out, "--stats", stats_file]
        + ["--roulette", "off", "--spp", spp, "--seed", seed, "--threads", str(THREADS), "--max-depth", depth],
        check=True,
    )
    stats = json.loads(stats_file.read_text())
    t, image, rays = stats["time"], stats["image"], stats["rays"]
    cpu = stats["busy"] * t["render_s"] * stats["threads"]
    print(json.dumps(dict(
        peer="weir", scene=scene, spp=image["spp"], threads=stats["threads"],
        load_s=t["parse_s"] + t["prepare_s"] + t["build_s"], render_s=[t["render_s"]], render_cpu_s=[cpu],
        total_s=t["total_s"], busy=stats["busy"], closest=rays["closest"] / image["samples"],
        occluded=rays["occluded"] / image["samples"], rss_MB=(stats["memory"]["peak_rss"] or 0) / 2**20)))


def run_embree(program, scene, threads):
    """Rates of bare traversal in millions of rays per second of one thread's processor time."""
    command = [program, ROOT / "scenes" / scene / "meshes", threads, EMBREE_SECONDS, *MESHES[scene]]
    text = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    rates = {}
    for line in text.splitlines():
        for name, key in EBENCH_KEEP.items():
            if line.startswith(name):
                rates[key] = float(re.search(r"([\d.]+) Mrays per CPU-second", line)[1])
    version = int(re.search(r"embree (\d+)", text)[1])
    print(json.dumps(dict(peer="embree", scene=scene, threads=int(threads), render_s=[0], rates=rates,
                          version=f"{version // 10000}.{version // 100 % 100}.{version % 100}")))


def record(*command):
    """Runs a command when the machine is quiet; its own JSON line joined with what was measured around it."""
    log = OUT / "bench.jsonl"
    line = shlex.join(str(c) for c in command)
    subprocess.run([sys.executable, SCRIPTS / "bench.py", "--wait", WAIT, "--out", log, line],
                   check=True, stdout=subprocess.DEVNULL)
    r = json.loads(log.read_text().splitlines()[-1])
    if r["rc"] != 0 or not r["run"]:
        sys.exit(f"bench.py: this failed; run it by hand to see why:\n  PEERS_ROOT={ROOT} {line}")
    return r


def build_ebench(weir, scene):
    """Bare Embree on the scene's rays, linked with the very library that Weir runs with."""
    linked = subprocess.run(["ldd", weir], check=True, stdout=subprocess.PIPE, text=True).stdout
    found = re.search(r"=> (\S*libembree4\S*)", linked)
    if not found:
        sys.exit(f"bench.py: {weir} is not linked with Embree, so there is nothing to hold it against")
    library = Path(found[1])
    source = (SCRIPTS / "ebench.c").read_text()
    changes = list(EBENCH_B) if scene == "b" else []
    for call in re.findall(r'bench\("([^"]+)",\w+,\w+,\d,T,sec\);', source):
        if call not in EBENCH_KEEP:
            source = re.sub(rf'bench\("{re.escape(call)}",[^;]*;', "", source)
    for old, new in changes:
        if source.count(old) != 1:
            sys.exit(f"bench.py: ebench.c has changed, {old!r} is not in it once")
        source = source.replace(old, new)
    code, program = OUT / f"ebench-{scene}.c", OUT / f"ebench-{scene}"
    code.write_text(source)
    subprocess.run(
        ["gcc", "-w", "-O3", "-march=native", f"-I{HERE.parent}", code, library, f"-Wl,-rpath,{library.parent}"]
        + [f"-Wl,-rpath-link,{library.parent}", "-lm", "-lpthread", "-o", program], check=True)
    return program


def multijitter(scene):
    """The scene for Mitsuba with its stratified sampler: the one that the scene names is its noisiest."""
    source, copy = ROOT / "scenes" / scene, ROOT / "scenes" / f"{scene}-multijitter"
    copy.mkdir(exist_ok=True)
    for folder in ("meshes", "textures"):
        if not (copy / folder).exists():
            (copy / folder).symlink_to(source / folder)
    text = (source / "mitsuba.xml").read_text()
    (copy / "mitsuba.xml").write_text(text.replace('sampler type="independent"', 'sampler type="multijitter"'))
    return copy.name


# --- Which runs a round has. ---


def commands(weir, scene, n):
    """Name, image and command of every renderer in round `n`."""
    python, bpy = ROOT / "venv/bin/python", ROOT / "venv-bpy/bin/python"

    def image(name, suffix=".npy"):
        return OUT / f"bench_{name}_{scene}_{n}{suffix}"

    def mitsuba(name, variant, place=scene):
        out = image(name)
        return name, out, [python, SCRIPTS / "run_mitsuba.py", place, variant, SPP, "--seed", n, "--out", out]

    def seeded(name, interpreter, script):
        out = image(name)
        return name, out, [interpreter, SCRIPTS / script, scene, SPP, "--seed", n + 1, "--out", out]

    exr = image("weir", ".exr")
    yield "weir", exr, [python, HERE, "weir", weir, scene, SPP, n, DEPTH, exr]
    yield mitsuba(BASE, "llvm_ad_rgb")
    # Two images give the noise; a third would be time better spent on another round.
    if n < 2:
        yield mitsuba("multijitter", "llvm_ad_rgb", multijitter(scene))
    if QUICK:
        return
    if n == 0:
        yield mitsuba("mitsuba-scalar_rgb", "scalar_rgb")
    if n < 2:
        yield seeded("cycles", bpy, "run_cycles.py")
        yield seeded("luxcore", python, "run_lux.py")


def measure(weir, scene):
    """All runs of a scene: by round, by name."""
    python, ebench = ROOT / "venv/bin/python", build_ebench(weir, scene)
    # Kernels are compiled once and kept on disk: whoever comes first must not pay for it.
    for place in (scene, multijitter(scene)):
        subprocess.run([python, SCRIPTS / "run_mitsuba.py", place, "llvm_ad_rgb", str(SPP), "--out",
                        OUT / "warm-up.npy"], check=True, stdout=subprocess.DEVNULL)
    rounds = []
    for n in range(ROUNDS):
        runs = {}
        for name, image, command in commands(weir, scene, n):
            print(f"bench: scene {scene}, round {n + 1} of {ROUNDS}, {NAMES[name]}", file=sys.stderr)
            runs[name] = record(*command) | {"image": image}
        for threads in (1, THREADS):
            runs[f"embree{threads}"] = record(python, HERE, "embree", ebench, scene, threads)
        rounds.append(runs)
    reference = OUT / f"bench_weir_{scene}_reference.exr"
    if ROUNDS > 1:
        print(f"bench: scene {scene}, reference of {16 * SPP} samples a pixel", file=sys.stderr)
        record(python, HERE, "weir", weir, scene, 16 * SPP, 1000, DEPTH, reference)
    last_edges = 0.0
    if HAS_EMITTERS[scene]:
        # One event more turns every last edge into a ray of its own.
        out = OUT / f"bench_weir_{scene}_deeper.exr"
        deeper = record(python, HERE, "weir", weir, scene, SPP, 0, DEPTH + 1, out)
        last_edges = max(deeper["run"]["closest"] - rounds[0]["weir"]["run"]["closest"], 0.0)
    return rounds, last_edges, reference


# --- What they say. ---


def seconds(run):
    return min(run["run"]["render_s"])


def cpu_seconds(run):
    cpu = run["run"]["render_cpu_s"]
    return min(cpu) if isinstance(cpu, list) else cpu


def load_seconds(run):
    j = run["run"]
    return j["load_s"] if "load_s" in j else j.get("setup_s", 0) + j.get("prep_s", 0)


def samples(run):
    """Millions of them."""
    return SIZE * SIZE * (run["run"].get("spp_done") or run["run"]["spp"]) / 1e6


def rate(run):
    return samples(run) / seconds(run)


def cpu_rate(run):
    return samples(run) / cpu_seconds(run)


def peak_mb(run):
    return run["run"]["rss_MB"] if run["run"]["peer"] == "weir" else run["peak_MB"]


def of(rounds, name, value):
    """`value` of a renderer's runs."""
    return [value(r[name]) for r in rounds if name in r]


def ratios(rounds, name, value):
    """Weir's `value` over another's, in each round that has both."""
    return [value(r["weir"]) / value(r[name]) for r in rounds if name in r]


def spread(values, digits=2):
    """Median, and the range if there is one."""
    if not values:
        return "–"
    text = f"{statistics.median(values):.{digits}f}"
    if len(values) > 1:
        text += f" ({min(values):.{digits}f} to {max(values):.{digits}f})"
    return text


def load_image(path):
    import numpy
    if path.suffix == ".npy":
        return numpy.load(path).astype(numpy.float64)
    import OpenImageIO
    pixels = OpenImageIO.ImageBuf(str(path)).get_pixels(OpenImageIO.FLOAT)
    pixels = pixels[:, :, :3]
    # Beside the others' images, for the scripts that compare those.
    numpy.save(path.with_suffix(".npy"), pixels)
    return pixels.astype(numpy.float64)


def errors(rounds, reference):
    """Noise of each renderer from pairs of seeds, plain and without the worst 0.1 % of pixels; how far each
    renderer's mean is from Weir's; and how well noise alone explains its distance from Weir."""
    import numpy
    images = {}
    for r in rounds:
        for name, run in r.items():
            if "image" in run:
                images.setdefault(name, []).append(load_image(run["image"]))
    # It only scales the error, so it need not be anyone's truth; but it must be none of the images that are
    # judged, whose own outliers it would then forgive.
    scale = load_image(reference)**2 + 1e-2

    def relative(a, b, trim):
        e = numpy.sort(((a - b)**2 / scale).mean(-1).ravel())
        return float(e[:len(e) - int(len(e) * trim)].mean())

    result = {}
    for name, group in images.items():
        pairs = [(a, b) for k, a in enumerate(group) for b in group[k + 1:]]
        if pairs:
            result[name] = {trim: statistics.mean(relative(a, b, trim) / 2 for a, b in pairs) for trim in (0, .001)}
            result[name]["mean"] = numpy.mean(group) / numpy.mean(images["weir"])
    for name, group in images.items():
        if name in result and name != "weir":
            apart = statistics.mean(relative(a, b, .001) for a in group for b in images["weir"])
            result[name]["explained"] = apart / (result[name][.001] + result["weir"][.001])
    return result


def print_speed(scene, rounds):
    print(f"\n### Scene {scene}: {SIZE}² pixels, {SPP} samples a pixel, {THREADS} threads\n")
    print("| | load s | render s | Msamples/s | Msamples per CPU-s | peak MB | Weir's speed over its | per CPU-s |")
    print("|---|---|---|---|---|---|---|---|")
    for name in NAMES:
        runs = [r[name] for r in rounds if name in r]
        if not runs:
            continue
        median = [statistics.median(map(f, runs)) for f in (load_seconds, seconds, rate, cpu_rate, peak_mb)]
        cells = "{:.2f} | {:.2f} | {:.3f} | {:.3f} | {:.0f}".format(*median)
        against = ("1", "1") if name == "weir" else (
            spread(ratios(rounds, name, rate)), spread(ratios(rounds, name, cpu_rate)))
        print(f"| {NAMES[name]} | {cells} | {against[0]} | {against[1]} |")
    print(f"\n- Weir over Mitsuba LLVM: **{spread(ratios(rounds, BASE, rate))}** by the clock, "
          f"**{spread(ratios(rounds, BASE, cpu_rate))}** per processor second")
    if any("mitsuba-scalar_rgb" in r for r in rounds):
        print(f"- Weir's peak memory over Mitsuba scalar's: **{spread(ratios(rounds, 'mitsuba-scalar_rgb', peak_mb))}**")
    print(f"- Weir's threads were busy {spread([100 * x for x in of(rounds, 'weir', lambda r: r['run']['busy'])], 1)} % "
          "of the rendering time")
    other = [r["foreign_frac"] for runs in rounds for r in runs.values()]
    print(f"- Other processes took {spread([100 * x for x in other], 0)} % of the machine"
          + ("; **not quiet: read the column per CPU-s, and do not quote the clock's**" if max(other) > .1 else ""))


def print_embree(rounds, last_edges):
    weir = rounds[0]["weir"]["run"]
    bounce, shadow = weir["closest"] - 1, weir["occluded"] - last_edges
    version = rounds[0]["embree1"]["run"]["version"]
    print(f"\nAgainst bare Embree {version}: what a sample's rays would cost were traversal all there is, over what a "
          f"sample does cost, in processor time. A sample of Weir's has 1 primary ray, {bounce:.2f} further closest "
          f"hits and {shadow:.2f} occlusion tests" +
          (f" (and {last_edges:.2f} last edges tried against the emitters alone, taken as free)" if last_edges else "") +
          ", each priced at bare Embree's rate for its kind in path order: "
          "samples/s × (1/primary + closest/bounce + occlusion/shadow).\n")
    print("| bare Embree on | Mrays/s per thread: primary | bounce | shadow | bounce, shuffled | Weir's share |")
    print("|---|---|---|---|---|---|")
    for threads in (1, THREADS):
        key, shares = f"embree{threads}", []
        for r in rounds:
            e = r[key]["run"]["rates"]
            shares.append(100 * cpu_rate(r["weir"]) * (1 / e["primary"] + bounce / e["bounce"] + shadow / e["shadow"]))
        rates = [statistics.median(r[key]["run"]["rates"][k] for r in rounds)
                 for k in ("primary", "bounce", "shadow", "shuffled")]
        cells = " | ".join(f"{x:.2f}" for x in rates)
        print(f"| {threads} thread{'s' * (threads > 1)} | {cells} | **{spread(shares, 0)} %** |")


def print_errors(rounds, reference):
    if ROUNDS < 2:
        print("\nNoise is not known: it takes ROUNDS=2 or more.")
        return
    found = errors(rounds, reference)
    print("\nTime to equal error: relMSE × seconds of rendering, over Weir's, as if error fell as 1/samples. relMSE is the "
          "mean of (A − B)² / (R² + 0.01) over pairs of seeds, halved, R a Weir image of "
          f"{16 * SPP} samples that is none of them; trimmed: without the worst 0.1 % of pixels. Noise alone explains "
          "the distance from Weir's images where the last column is 1.\n")
    print("| | relMSE | trimmed | time to Weir's error | trimmed | CPU-s, trimmed | mean over Weir's | distance / noise |")
    print("|---|---|---|---|---|---|---|---|")
    own = found["weir"]
    for name, e in found.items():
        # Weir's cost from the same rounds: another renderer may have run in some of them only.
        clock, cpu = (1 / statistics.median(ratios(rounds, name, f)) for f in (seconds, cpu_seconds))
        factors = [clock * e[0] / own[0], clock * e[.001] / own[.001], cpu * e[.001] / own[.001]]
        cells = [f"{e[0]:.5f}", f"{e[.001]:.5f}", *(f"{x:.2f}" for x in factors), f"{e['mean']:.4f}"]
        print(f"| {NAMES[name]} | {' | '.join(cells)} | " + (f"{e['explained']:.3f} |" if "explained" in e else "|"))


def main(weir):
    OUT.mkdir(exist_ok=True)
    results = {scene: measure(weir, scene) for scene in SCENES}
    version = subprocess.run([weir, "--version"], check=True, stdout=subprocess.PIPE, text=True).stdout.strip()
    print(f"{version}, {time.strftime('%Y-%m-%d')}, rounds by turns: {ROUNDS}; medians, with the range of the rounds")
    for scene, (rounds, last_edges, reference) in results.items():
        print_speed(scene, rounds)
        print_embree(rounds, last_edges)
        print_errors(rounds, reference)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["weir", *arguments]:
            run_weir(*arguments)
        case ["embree", *arguments]:
            run_embree(*arguments)
        case [weir]:
            main(weir)
