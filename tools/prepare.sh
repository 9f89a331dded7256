#!/bin/bash
# prepare.sh TARGET_DIR embree|all: brings what a build needs: Embree 4.3 or later and, for `all`, a C++
# compiler and the crates.
#
# Invariant: a second run finds everything in place and needs neither network nor root; what is unpacked
# appears whole or not at all.
# Never: replaces an Embree that build.rs would take. The places and the test are the same as build.rs's.
set -euo pipefail
cd "$(dirname "$0")/.."

target=$1
scope=$2

wheel='embreex==4.4.0.post1'
wheel_sha256=2cd0f7d5c6342e6247e31f700761689cae7829454d8c6de0c41e62124a023e1f

say() { echo "weir: $*"; }
fail() {
  echo "weir: $*" >&2
  exit 1
}

# Whether the directory $1 holds an Embree with the ABI that embree4-sys declares; see build.rs.
fits() {
  [ -e "$1/libembree4.so" ] && grep -qaF rtcSetGeometryInstancedScenes "$1/libembree4.so" || return 1
  local config levels
  for config in "$1"/../include/embree4/rtcore_config.h "$1"/../../include/embree4/rtcore_config.h; do
    [ -e "$config" ] || continue
    levels=$(sed -n 's/^#define RTC_MAX_INSTANCE_LEVEL_COUNT *//p' "$config")
    [ "${levels:-1}" = 1 ] || return 1
  done
}

system_embree() {
  local directories=() directory
  IFS=: read -ra directories <<<"${LIBRARY_PATH:-}"
  for directory in "${directories[@]}" /usr/local/lib /usr/local/lib64 "/usr/lib/$(uname -m)-linux-gnu" \
    /usr/lib64 /usr/lib; do
    if [ -n "$directory" ] && fits "$directory"; then return 0; fi
  done
  return 1
}

own_embree() {
  local below
  for below in . lib lib64 lib/x86_64-linux-gnu; do
    if fits "$EMBREE_DIR/$below"; then return 0; fi
  done
  return 1
}

# The version of libembree-dev that apt would install; empty if none or unknown.
packaged_embree() {
  command -v apt-cache >/dev/null || return 0
  apt-cache policy libembree-dev 2>/dev/null | sed -n 's/^ *Candidate: //p' | grep -v '(none)' || true
}

may_install() { command -v apt-get >/dev/null && { [ "$(id -u)" = 0 ] || sudo -n true 2>/dev/null; }; }

has_pip() { python3 -m pip --version >/dev/null 2>&1; }

# A C++ compiler that also links: the compiler without the C library's start files is not enough.
compiles() {
  command -v cc >/dev/null && command -v c++ >/dev/null || return 1
  local scratch answer=0
  scratch=$(mktemp -d)
  echo '#include <string>
int main() { return std::string("weir").size() != 4; }' >"$scratch/a.cpp"
  c++ "$scratch/a.cpp" -o "$scratch/a" 2>/dev/null || answer=1
  rm -rf "$scratch"
  return $answer
}

unpack_wheel() {
  local scratch library
  mkdir -p "$target"
  # Beside its place, so that the last step is a rename.
  scratch=$(mktemp -d "$target/embree.XXXXXX")
  # shellcheck disable=SC2064 # The directory of now is meant.
  trap "rm -rf '$scratch'" EXIT
  say "fetching Embree 4.4 (14 MB)"
  python3 -m pip download --quiet --no-deps --only-binary=:all: --python-version 3.11 --implementation cp \
    --platform manylinux_2_28_x86_64 --dest "$scratch/wheel" "$wheel" ||
    fail "Embree could not be fetched; set EMBREE_DIR to an Embree 4.3 or later of your own, or try again"
  echo "$wheel_sha256  $(echo "$scratch"/wheel/*.whl)" | sha256sum --check --quiet >&2 ||
    fail "what was fetched for $wheel is not what was pinned"
  python3 -m zipfile -e "$scratch"/wheel/*.whl "$scratch/content"
  mkdir -p "$scratch/embree/lib"
  mv "$scratch"/content/embreex.libs/*.so.* "$scratch/embree/lib/"
  cp "$scratch"/content/*.dist-info/METADATA "$scratch"/content/*.dist-info/licenses/* "$scratch/embree/"
  # Its SONAME carries a hash: the linker needs the plain name.
  library=$(basename "$(echo "$scratch"/embree/lib/libembree4-*.so.4)")
  ln -s "$library" "$scratch/embree/lib/libembree4.so"
  chmod -R a+rX "$scratch/embree"
  fits "$scratch/embree/lib" || fail "the wheel $wheel holds no Embree 4.3 or later"
  rm -rf "$target/embree"
  mv -T "$scratch/embree" "$target/embree"
  rm -rf "$scratch"
  trap - EXIT
}

# Says where Embree is to come from: `here`, `package` or `wheel`.
embree_source() {
  if [ -n "${EMBREE_DIR:-}" ]; then
    own_embree || fail "EMBREE_DIR=$EMBREE_DIR holds no Embree 4.3 or later: unset it and run \`make embree\`"
    echo here
  elif system_embree || fits "$target/embree/lib"; then
    echo here
  elif dpkg --compare-versions "$(packaged_embree)" ge 4.3 2>/dev/null && { may_install || ! has_pip; }; then
    echo package
  elif [ "$(uname -sm)" = 'Linux x86_64' ]; then
    echo wheel
  else
    fail "no Embree for $(uname -sm) is known here; install Embree 4.3 or later and set EMBREE_DIR to it"
  fi
}

if [ -e "$target/embree" ] && [ ! -d "$target/embree" ]; then fail "$target/embree is in the way"; fi

packages=()
if [ "$scope" = all ]; then
  command -v cargo >/dev/null || fail "there is no cargo: install Rust 1.88 or later with rustup, then run make again"
  compiles || packages+=(g++ libc6-dev)
fi

source=$(embree_source)
if [ "$source" != here ] && [ -z "$(packaged_embree)" ] && may_install; then
  # A fresh machine has no package lists, and so does not know yet whether it packages Embree.
  say "reading the package lists"
  if [ "$(id -u)" = 0 ]; then apt-get -qq update >/dev/null; else sudo -n apt-get -qq update >/dev/null; fi || true
  source=$(embree_source)
fi
case $source in
  package) packages+=(libembree-dev) ;;
  wheel) has_pip || packages+=(python3 python3-pip) ;;
esac

if [ ${#packages[@]} -gt 0 ]; then tools/packages.sh "${packages[@]}"; fi

if [ "$source" = package ] && ! system_embree; then
  say "this system's Embree is not fit for Weir"
  source=wheel
  has_pip || tools/packages.sh python3 python3-pip
fi
if [ "$source" = wheel ]; then unpack_wheel; fi
if [ "$scope" = embree ]; then
  if [ -n "${EMBREE_DIR:-}" ]; then
    say "Embree is in $EMBREE_DIR (EMBREE_DIR)"
  elif system_embree; then
    say "Embree is installed in the system"
  else
    say "Embree is in $target/embree"
  fi
  exit 0
fi

host=$(rustc -vV | sed -n 's/^host: //p')
if ! cargo fetch --locked --offline --target "$host" >/dev/null 2>&1; then
  say "fetching the crates"
  cargo fetch --quiet --locked --target "$host"
fi
