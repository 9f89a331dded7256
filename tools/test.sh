#!/bin/bash
# test.sh TARGET_DIR [CARGO_FLAG...]: every check that a change must pass, the cheapest first.
#
# Invariant: ends in one line `N passed, N failed, N skipped` over all of cargo's test binaries, and fails if
# any check did or if no test ran.
# Never: fetches anything.
set -euo pipefail
cd "$(dirname "$0")/.."

target=$1
shift
log=$target/test.log

if ! { cargo fmt --version && cargo clippy --version; } >/dev/null 2>&1; then
  rustup component add rustfmt clippy
fi

step() {
  echo "== $*"
  "$@"
}

step cargo fmt --all --check
step cargo clippy --all-targets "$@" -- -D warnings
RUSTDOCFLAGS='-D warnings' step cargo doc --no-deps "$@"
step cargo check --no-default-features --all-targets "$@"

# Documentation tests first, so that cargo's own closing line is that of a binary with tests in it.
mkdir -p "$target"
status=0
{
  step cargo test --doc "$@" && step cargo test --lib --bins --tests --examples "$@"
} 2>&1 | tee "$log" || status=$?

awk '/^test result:/ { passed += $4; failed += $6; skipped += $8 }
  END { printf "%d passed, %d failed, %d skipped\n", passed, failed, skipped; exit passed == 0 }' "$log"
exit $status
