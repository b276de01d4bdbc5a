#!/usr/bin/env bash
# Makes every figure of docs/numbers.md again: JSON and plots into a folder. On a quiet machine this takes about five minutes.
#
#     cargo build --release && benches/numbers.sh [FOLDER]      # default: runs/numbers
#
# PYTHON names an interpreter with benches/requirements.txt; without one the part of numpy is left out, and said so.
set -eu
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=${1:-runs/numbers}
domvs=${DOMVS:-target/release/domvs}
python=${PYTHON:-python3}
mkdir -p "$out"

say() { printf '\n== %s\n' "$1"; }

measure() { # measure NAME verb options... : the rows as NAME/…json, plots beside them, a table on the terminal
  local name=$1
  shift
  say "$name: domvs bench $*"
  "$domvs" bench "$@" --out "$out/$name"
}

{
  date -u +%FT%TZ
  "$domvs" --version
  uname -sr
  sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | sort | uniq -c
  free -m 2>/dev/null | sed -n 2p
  uptime
} | tee "$out/machine.txt"

# The budgets: whole twist, one thread.
measure budget step --steps 1000
measure budget-adaptive-window step --steps 1000 --window adaptive
measure methods step --method hahn,krawtchouk,tchebichef,cosine --order 16 --steps 400
measure pixels step --method photometric,gaussian_mixture --steps 200 --seconds 6
measure options-light step --light --order 16
measure options-noise-floor step --noise-floor --order 16
# How it grows.
measure sizes step --depth map --size 96x72,97x71,160x120,320x240,640x480,800x600,1280x720,1920x1080 --order 3,8,16,24 --steps 100
measure orders step --depth map --order 3,4,6,8,12,16,20,24,32,40 --steps 200
# The instructions.
for path in avx512 avx2 sse4.2 sse2 neon fallback; do
  if "$domvs" bench step --path "$path" --size 16x16 --order 3 --steps 1 --json >/dev/null 2>&1; then
    measure "path-$path" step --path "$path" --steps 300
  fi
done
# The network.
measure roundtrip roundtrip --samples 1000 --seconds 20
measure load load --seconds 20
measure overload load --tasks 20 --overload 3 --seconds 10
measure tasks load --tasks 1,2,4,8,20 --rate 0 --seconds 6
if command -v taskset >/dev/null && [ "$(nproc)" -ge 2 ]; then
  say "one core for everything, then two"
  # A high order, so that the law is what takes the time, not the clients.
  # Cameras that wait for each answer, and cameras that have the next frame there before it.
  for ahead in 1 3; do
    taskset -c 0 "$domvs" bench load --tasks 2,4,8 --order 24 --rate 0 --ahead $ahead --seconds 6 --out "$out/one-core-$ahead"
    taskset -c 0,1 "$domvs" bench load --tasks 2,4,8 --order 24 --rate 0 --ahead $ahead --seconds 6 --out "$out/two-cores-$ahead"
  done
fi
# The peer that runs everywhere.
say "numpy"
if "$python" -c 'import numpy, PIL' 2>/dev/null; then
  for order in 8 16; do
    "$python" benches/numpy_step.py "$domvs" --order "$order" --rounds 12 --json | tee "$out/numpy-$order.json"
  done
else
  echo "left out: $python has no numpy and pillow (PYTHON=… names another)"
fi
