#!/usr/bin/env bash
# Sets up what is missing, then bakes a mesh and shows it: in a window where there is a display, else as a
# picture in the current folder.
#
#   ./demo.sh                               the demonstration mesh
#   ./demo.sh bunny.ply --size 50mm ...     any mesh, with the options of python -m clsss.view
set -euo pipefail
here=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")" && pwd)
start=$PWD
cd -- "$here"
# shellcheck source=scripts/setup.sh
source scripts/setup.sh
setup .
python=$here/.venv/bin/python
opens_window=$(
    "$python" -c 'from clsss.opengl import open_window; open_window((16, 16), visible=False)' >/dev/null 2>&1 &&
        echo yes || echo no
)
cd -- "$start"
if [[ $# -eq 0 ]]; then
    set -- demo
fi
if [[ $opens_window == yes || " $* " == *" --screenshot"* ]]; then
    exec "$python" -m clsss.view "$@"
fi
picture=$start/clsss-demo.png
if [[ ! -w $start ]]; then
    picture=$(mktemp -d)/clsss-demo.png
fi
echo "no display: drawing a picture instead of opening a window" >&2
exec "$python" -m clsss.view "$@" --screenshot "$picture"
