#!/bin/bash
# bench.sh [WEIR]: Weir against Mitsuba, Cycles, LuxCore and bare Embree on the same scenes, by turns, in one
# run; prints tables of ratios, and appends one JSON line a run to $PEERS_ROOT/out/bench.jsonl.
#
#   ROUNDS=3 SPP=16 SCENES='a b'   how much; two rounds give a second seed, which the noise needs
#   QUICK=1                        only Mitsuba's LLVM variant beside Weir and Embree
#   WAIT=60                        seconds to wait, before each run, for other processes to let go
#   PEERS_ROOT=target/peers        where the other renderers and the scenes are, or will be put
#   PEERS_SCRIPTS=../shared/peers  scripts that set up and run the other renderers
#   EB_ROBUST=1, EB_HIGH=1         bare Embree in robust mode, or over a tree of high build quality
#
# Invariant: every ratio compares runs of one round, on 2 threads each, at equal samples per pixel.
# Never: changes a scene or another renderer, nor compares with a number from another day.
set -euo pipefail
cd "$(dirname "$0")/.."

fail() {
  echo "bench.sh: $*" >&2
  exit 1
}

target=${CARGO_TARGET_DIR:-target}
weir=$(realpath "${1:-$target/release/weir}")
[ -x "$weir" ] || fail "there is no $weir: run \`make build\`"

scripts=${PEERS_SCRIPTS:-../shared/peers}
[ -e "$scripts/setup.sh" ] || fail "no scripts to run other renderers with: PEERS_SCRIPTS must name their directory"
PEERS_SCRIPTS=$(realpath "$scripts")

mkdir -p "${PEERS_ROOT:-$target/peers}"
PEERS_ROOT=$(realpath "${PEERS_ROOT:-$target/peers}")
export PEERS_SCRIPTS PEERS_ROOT
if [ ! -x "$PEERS_ROOT/venv/bin/python" ] || [ ! -x "$PEERS_ROOT/venv-bpy/bin/python" ] ||
  [ ! -e "$PEERS_ROOT/scenes/b/scene.pbrt" ]; then
  echo "bench.sh: setting up the other renderers in $PEERS_ROOT (about 2 GB)" >&2
  sh "$PEERS_SCRIPTS/setup.sh" >&2
fi
llvm=/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1
if [ -e "$llvm" ]; then export DRJIT_LIBLLVM_PATH=${DRJIT_LIBLLVM_PATH:-$llvm}; fi

exec "$PEERS_ROOT/venv/bin/python" tools/bench/bench.py "$weir"
