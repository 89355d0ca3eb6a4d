#!/usr/bin/env bash
# The walk of a newcomer, timed: fresh clone, make demo, report on the screen.
# scripts/walk.sh [FOLDER]   Installation is timed apart; the aim for the rest is 60 s.
set -euo pipefail
here=$(cd "$(dirname "$0")/.." && pwd)
folder=${1:-$(mktemp -d)}
browser=$(command -v chromium || command -v chromium-browser || command -v google-chrome || true)

now() { date +%s.%N; }
took() { awk -v a="$1" -v b="$2" 'BEGIN { printf "%.1f s", b - a }'; }

begin=$(now)
git clone --quiet "$here" "$folder/modelgap"
cloned=$(now)
cd "$folder/modelgap"
# WALK_VENV=FOLDER takes an installed environment instead of making one.
if [ -n "${WALK_VENV:-}" ]; then
    mkdir .venv
    ln -s "$(cd "$WALK_VENV" && pwd)"/* .venv/
    rm -f .venv/*.stamp
    touch .venv/core.stamp
    export PYTHONPATH=$PWD # before the checkout that the environment is of
else
    make --no-print-directory .venv/core.stamp
fi
installed=$(now)
make --no-print-directory demo | tee demo.txt
shown=$(sed -n 's/^report: //p' demo.txt)
[ -s "$shown" ] || { echo "walk: no report was written" >&2; exit 1; }
made=$(now)
if [ -n "$browser" ]; then
    timeout 60 "$browser" --headless --no-sandbox --disable-gpu --window-size=1200,1600 \
        --screenshot="$folder/report.png" "file://$(realpath "$shown")" >/dev/null 2>&1
fi
done_=$(now)

echo "clone           $(took "$begin" "$cloned")"
echo "installation    $(took "$cloned" "$installed")"
echo "make demo       $(took "$installed" "$made")"
echo "report on screen $(took "$made" "$done_")${browser:+ ($folder/report.png)}"
awk -v a="$begin" -v b="$cloned" -v c="$installed" -v d="$done_" \
    'BEGIN { printf "walk            %.1f s without the installation (aim: 60 s)\n", b - a + d - c }'
