#!/bin/bash
# packages.sh NAME...: installs Debian packages if this user may, else says what to type and fails.
#
# Invariant: exits 0 only when apt says that every package is installed.
# Never: asks a question, or waits for a password.
set -euo pipefail

as_root=()
if [ "$(id -u)" != 0 ]; then
  as_root=(sudo -n)
fi

if ! command -v apt-get >/dev/null; then
  echo "weir: this machine has no apt-get; install by its own means what Debian calls: $*" >&2
  exit 1
fi
if [ "$(id -u)" != 0 ] && ! sudo -n true 2>/dev/null; then
  echo "weir: something is missing, and installing it takes root; type: sudo apt-get update && sudo apt-get install -y --no-install-recommends $*" >&2
  exit 1
fi

apt() {
  # The lock is waited for: a fresh machine's own updates often hold it.
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=300 \
    -o Dpkg::Use-Pty=0 "$@"
}

echo "weir: installing $*"
# Without fresh lists first: they are often there, and then this is all it takes.
if ! apt install -y --no-install-recommends "$@" >/dev/null 2>&1; then
  apt update >/dev/null
  apt install -y --no-install-recommends "$@" >/dev/null
fi
