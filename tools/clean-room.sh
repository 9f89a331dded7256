#!/bin/bash
# clean-room.sh REPO WORK_DIR [SUITE]: proves `.ci/run`, `make test` and `make demo` on a machine that has
# nothing but a minimal Debian, Rust and a network, and then once more without the network.
#
# Invariant: the room gets this machine's way to its registries (apt, pip and cargo settings, certificates),
# the Rust toolchain, REPO's HEAD and the folder shared/ beside REPO if there is one; nothing else.
# Never: writes outside WORK_DIR, or keeps a mount once it ends. Needs root and debootstrap; a WORK_DIR
# whose room exists is used again, so delete WORK_DIR/SUITE to start from a bare system.
set -euo pipefail

repo=$(realpath "$1")
work=$2
suite=${3:-bookworm}
room=$work/$suite

[ "$(id -u)" = 0 ] || {
  echo "clean-room.sh: changing the root directory takes root" >&2
  exit 1
}

if [ ! -e "$room/weir-room" ]; then
  command -v debootstrap >/dev/null || "$(dirname "$0")/packages.sh" debootstrap
  mirror=$(apt-get indextargets --format '$(SITE)' 'Created-By: Packages' | head -1)
  mkdir -p "$work"
  rm -rf "$room.new"
  # The smallest variant: no compiler, no Python, no make.
  debootstrap --variant=minbase --include=ca-certificates "$suite" "$room.new" "$mirror" >"$work/debootstrap.log"
  rm -rf "$room"
  mv "$room.new" "$room"

  # How this machine reaches its registries.
  cp -aL /etc/resolv.conf /etc/hosts "$room/etc/"
  cp -a /etc/apt/apt.conf.d/. "$room/etc/apt/apt.conf.d/"
  if [ -e /etc/pip.conf ]; then cp -a /etc/pip.conf "$room/etc/"; fi
  for config in .config/pip/pip.conf .pip/pip.conf .cargo/config.toml .cargo/config; do
    if [ -e "$HOME/$config" ]; then install -D "$HOME/$config" "$room/root/$config"; fi
  done
  cp -aL /etc/ssl/certs/ca-certificates.crt "$room/etc/ssl/certs/"
  cp -a /usr/local/share/ca-certificates/. "$room/usr/local/share/ca-certificates/" 2>/dev/null || true

  # Rust, and of its toolchains only the one that is used.
  toolchain=$(rustup show active-toolchain | cut -d' ' -f1)
  mkdir -p "$room/root/.cargo" "$room/root/.rustup/toolchains"
  cp -a "$HOME/.cargo/bin" "$room/root/.cargo/"
  cp -aL "$HOME/.rustup/toolchains/$toolchain" "$room/root/.rustup/toolchains/"
  cp -a "$HOME/.rustup/settings.toml" "$room/root/.rustup/"
  touch "$room/weir-room"
fi

rm -rf "$room/weir" "$room/shared"
git clone -q --no-hardlinks "file://$repo" "$room/weir"
if [ -d "$repo/../shared" ]; then cp -a "$repo/../shared" "$room/shared"; fi

# Certificates, proxies and time-outs by environment, as this machine has them; a folder of wheels is not
# something a bare machine has.
environment=(HOME=/root "PATH=/root/.cargo/bin:/usr/sbin:/usr/bin:/sbin:/bin" LANG=C.UTF-8 CI=true)
while IFS= read -r -d '' variable; do
  case $variable in
    PIP_FIND_LINKS=*) ;;
    PIP_*=* | CARGO_HTTP_*=* | CARGO_NET_*=* | SSL_CERT_*=* | *_CA_BUNDLE=* | *_proxy=* | *_PROXY=*)
      environment+=("$variable")
      ;;
  esac
done < <(env -0)

# inside NETWORK COMMAND: runs a command in the clone; `unshare` takes the mounts away again.
inside() {
  local apart=(--mount --pid --fork)
  if [ "$1" = off ]; then apart+=(--net); fi
  shift
  unshare "${apart[@]}" /bin/bash -c '
    set -e
    mount -t proc proc "$1/proc"
    mount --rbind /dev "$1/dev"
    exec chroot "$1" /usr/bin/env -i "${@:3}" /bin/bash -o pipefail -c "cd /weir && $2"
  ' inside "$room" "$*" "${environment[@]}" </dev/null
}

step() {
  local begin=$SECONDS
  echo "== clean room ($suite, network $1): $2"
  inside "$@"
  echo "== clean room ($suite, network $1): $2: done in $((SECONDS - begin)) s"
}

step on 'bash .ci/run'
step on 'make demo'
step off 'bash .ci/run'
step off 'make demo'
step off 'make test'
# Nothing must be left for a second build to do.
step off 'make build >/tmp/second 2>&1 && cat /tmp/second && ! grep -q Compiling /tmp/second'
# Below another path binaries must still find their Embree: the test that asks it most is run from there.
step off 'rm -rf /tmp/moved && mv target /tmp/moved &&
  /tmp/moved/release/weir render scenes/furnace.pbrt --spp 4 -o /tmp/furnace.exr'
echo "== clean room ($suite): all steps passed"
