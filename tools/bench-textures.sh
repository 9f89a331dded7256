#!/bin/bash
# bench-textures.sh [WEIR]: textures larger than memory, measured; two parts, each if its means are there.
#
#   trace   filtered look-ups a CPU-second on a trace of look-ups, Weir's tile cache against
#           OpenImageIO's TextureSystem, by turns, on the same .tx files, in one run (needs
#           $OIIO_ROOT with tx/*.tx and the program oiio_bench; ../shared/peers/oiio/run.sh makes both):
#           first with the other's way of filtering, so that both do the same work, then (last
#           column) with Weir's own trilinear filter and EWA, by the door that shading uses
#   scene   a generated city whose textures take 4.4 GB: time at a sixth and a twentieth of the
#           footprint over the time with everything resident, all reads from the disk itself
#
#   PARTS='trace scene' ROUNDS=3    which, and how many times
#   READS=direct                    Weir reads the trace's files past the system's page cache, which it
#                                   else only copies from; the other reads through it
#   KINDS, CACHES, THREADS          rows of the trace part ('coherent camera incoherent aniso', '1024 256 64', '1 2')
#   SCENE=DIR                       a generated scene that is there already
#   SPP=32 SIZE=960x540             of the scene part
#
# Invariant: every ratio compares runs of one round. Never quotes a number from another day.
set -euo pipefail
cd "$(dirname "$0")/.."

target=${CARGO_TARGET_DIR:-target}
weir=$(realpath "${1:-$target/release/weir}")
parts=${PARTS:-trace scene}
rounds=${ROUNDS:-3}
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT

median() { sort -g | awk '{v[NR] = $1} END {print NR % 2 ? v[(NR + 1) / 2] : (v[NR / 2] + v[NR / 2 + 1]) / 2}'; }
field() { grep -m1 -o "\"$1\": *[0-9.e+-]*" | sed 's/.*: *//'; }

if [[ $parts == *trace* ]]; then
  root=${OIIO_ROOT:-$target/oiio}
  if [ ! -x "$root/oiio_bench" ] || [ ! -e "$root/tx" ]; then
    echo "bench-textures.sh: left out the trace: no oiio_bench and tx/ in $root (OIIO_ROOT)" >&2
  else
    cargo build --release --example texture_trace
    trace=$target/release/examples/texture_trace
    cat "$root"/tx/*.tx >/dev/null # the system has the files in memory: the caches are compared, not the disk
    declare -A lookups=([coherent]=4194304 [camera]=2097152 [incoherent]=98304 [aniso]=65536)
    echo "| trace | cache MB | threads | pass | OpenImageIO, M/CPU-s | Weir, M/CPU-s | ratio (min..max) | probes | largest difference of means | Weir's own filters, M/CPU-s | ratio |"
    echo "|---|--:|--:|---|--:|--:|--:|--:|--:|--:|--:|"
    for kind in ${KINDS:-coherent camera incoherent aniso}; do
      for cache in ${CACHES:-1024 256 64}; do
        for threads in ${THREADS:-1 2}; do
          : >"$out/oiio" && : >"$out/weir" && : >"$out/own"
          for _ in $(seq "$rounds"); do
            "$root/oiio_bench" "$root/tx" "$cache" "$threads" "$kind" "${lookups[$kind]}" 2 >>"$out/oiio"
            "$trace" "$root/tx" "$cache" "$threads" "$kind" "${lookups[$kind]}" 2 >>"$out/weir"
            OWN=1 "$trace" "$root/tx" "$cache" "$threads" "$kind" "${lookups[$kind]}" 2 >>"$out/own"
          done
          python3 - "$out/oiio" "$out/weir" "$out/own" <<'PY'
import json, statistics, sys
oiio, weir, own = ([json.loads(line) for line in open(path)] for path in sys.argv[1:])
for which in ("cold", "warm"):
    a = [r for r in oiio if r["pass"] == which]
    b = [r for r in weir if r["pass"] == which]
    c = [r for r in own if r["pass"] == which]
    if any(x["trace_fnv"] != y["trace_fnv"] or x["lookups"] != y["lookups"] for x, y in zip(a, b)):
        sys.exit("the traces differ")
    speed = lambda rows: [r["mlookups_per_cpu_s"] for r in rows]
    ratios = sorted(y / x for x, y in zip(speed(a), speed(b)))
    owns = statistics.median(y / x for x, y in zip(speed(a), speed(c)))
    probes = statistics.median(y["bilinear_probes"] / x["bilinear_probes"] for x, y in zip(a, b))
    means = max(abs(p - q) for x, y in zip(a, b) for p, q in zip(x["mean_rgb"], y["mean_rgb"]))
    print("| %s | %g | %d | %s | %.3f | %.3f | **%.2f** (%.2f..%.2f) | %.3f | %.1e | %.3f | %.2f |" % (
        a[0]["kind"], a[0]["cache_mb"], a[0]["threads"], which, statistics.median(speed(a)),
        statistics.median(speed(b)), statistics.median(ratios), ratios[0], ratios[-1], probes, means,
        statistics.median(speed(c)), owns))
PY
        done
      done
    done
  fi
fi

if [[ $parts == *scene* ]]; then
  scene=${SCENE:-$target/bench-city}
  [ -e "$scene/scene.pbrt" ] || "$weir" generate city --triangles 2M --texture-bytes 4400M -o "$scene"
  # Generated files may still be in the system's memory, where a render would find them.
  forget() { python3 -c 'import os, sys
for directory, _, files in os.walk(sys.argv[1]):
    for name in files:
        file = os.open(os.path.join(directory, name), os.O_RDONLY)
        os.fsync(file)
        os.posix_fadvise(file, 0, 0, os.POSIX_FADV_DONTNEED)' "$scene"; }
  run() { forget && "$weir" "$scene/scene.pbrt" --size "${SIZE:-960x540}" --spp "${SPP:-32}" --texture-memory "$1" \
    --stats "$out/s.json" -o "$out/$2.exr" -q; }
  run 16G all
  footprint=$(field footprint_bytes <"$out/s.json")
  echo
  echo "Footprint $footprint bytes of $(field textures <"$out/s.json") of textures."
  : >"$out/all" && : >"$out/6" && : >"$out/20"
  for _ in $(seq "$rounds"); do
    run 16G all && all=$(field render_s <"$out/s.json")
    for part in 6 20; do
      run $((footprint / part)) "$part" && time=$(field render_s <"$out/s.json")
      echo "$time $all" | awk '{print $1 / $2}' >>"$out/$part"
      cp "$out/s.json" "$out/s$part.json"
    done
  done
  for part in 6 20; do
    echo "At 1/$part of it: $(median <"$out/$part") times the time with everything resident ($(sort -g "$out/$part" | tr '\n' ' '))," \
      "peak $(field peak <"$out/s$part.json") of $((footprint / part)) bytes, pressure $(field pressure <"$out/s$part.json");" \
      "$("$weir" diff "$out/all.exr" "$out/$part.exr" | tail -1)."
  done
fi
