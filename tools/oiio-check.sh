#!/bin/bash
# oiio-check.sh WEIR [OIIO_BIN]: OpenImageIO reads what `weir texture` writes, level by level, with the
# right texels. WEIR is the program, OIIO_BIN the folder of oiiotool and idiff (else they are on the path).
#
# Not part of `make test`: OpenImageIO is not needed to build or test Weir. One way to have it, in a folder
# of its own:  python3 -m venv oiio && oiio/bin/pip install openimageio==3.2.2.0
#
# Invariant: ends in one line `N checks, M failed`, and fails if any did.
# Never: writes outside a temporary folder.
set -uo pipefail

weir=$(realpath "$1")
[ $# -gt 1 ] && PATH="$(realpath "$2"):$PATH"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work" || exit 2

checks=0
failed=0
# check NAME COMMAND...: the command succeeds.
check() {
  checks=$((checks + 1))
  if ! "${@:2}" >out.log 2>&1; then
    failed=$((failed + 1))
    echo "FAILED $1: ${*:2}"
    sed 's/^/    /' out.log | head -20
  fi
}

# header FILE W H: as OpenImageIO reads it: tiles, texture tags, and as many levels as halving takes, of
# the right sizes.
header() {
  local w=$2 h=$3 sizes="$2x$3"
  while [ "$w" != 1 ] || [ "$h" != 1 ]; do
    w=$((w > 1 ? w / 2 : 1)) h=$((h > 1 ? h / 2 : 1))
    sizes="$sizes ${w}x$h"
  done
  oiiotool --info -v -a "$1"
  oiiotool --info -v -a "$1" >info.log
  { [ "$2x$3" = 1x1 ] || grep -qE "MIP-map levels: $sizes *$" info.log; } &&
    grep -q 'tile size: 64 x 64' info.log &&
    grep -q 'textureformat: "Plain Texture"' info.log &&
    grep -q 'wrapmodes: "periodic,periodic"' info.log &&
    grep -q 'weir:source=[0-9a-f]\{32\} ' info.log
}

# same A B: equal texels at the finest level, all channels.
same() { idiff -fail 0 -failpercent 0 -hardfail 0 "$1" "$2"; }

# coarse FILE LEVEL W H LIMIT: the level is the box filter of the one before.
coarse() {
  oiiotool "$1" --selectmip $(($2 - 1)) -d float --resize:filter=box "$3x$4" \
    "$1" --selectmip "$2" -d float --fail "$5" --warn "$5" --diff
}

for size in 130x67 1x1 1x300 65x64; do
  w=${size%x*} h=${size#*x}
  uniform="noise:type=uniform:min=0:max=1"
  gaussian="noise:type=gaussian:mean=1:stddev=2"
  oiiotool --pattern $uniform "$size" 3 -d uint8 -o rgb8.png
  oiiotool --pattern $uniform "$size" 1 -d uint16 -o grey16.png
  oiiotool --pattern $gaussian "$size" 3 -d half -o half.exr
  oiiotool --pattern $gaussian "$size" 4 --chnames R,G,B,A -d float -o alpha.exr
  oiiotool --pattern $gaussian "$size" 1 -d float -o grey.tif
  for source in rgb8.png grey16.png half.exr alpha.exr grey.tif; do
    for out in none.tx zip.tx none.exr zip.exr; do
      what="$size $source -> $out"
      out=${source%.*}.$out
      compression=${out#*.} compression=${compression%.*}
      check "$what: written" "$weir" texture "$source" -o "$out" --compression "$compression"
      check "$what: header" header "$out" "$w" "$h"
      # Where nothing is converted, texels are the source's.
      case $source,$out in
        rgb8.png,*.exr | grey16.png,*) ;;
        *) check "$what: texels" same "$source" "$out" ;;
      esac
    done
  done
done

# Levels against an independent box filter, where sizes are even and numbers linear.
oiiotool --pattern noise:type=uniform:min=0:max=1 256x256 3 -d float -o even.exr
"$weir" texture -q even.exr -o even.tx
"$weir" texture -q even.exr -o even.t.exr
for l in 1 2 3 4 5 6 7 8; do
  check "level $l of TIFF" coarse even.tx $l $((256 >> l)) $((256 >> l)) 1e-6
  check "level $l of EXR" coarse even.t.exr $l $((256 >> l)) $((256 >> l)) 1e-6
done

# Reads every texel of every level.
check "statistics of all levels" oiiotool --stats -a even.tx

echo "$checks checks, $failed failed"
[ $failed = 0 ]
