#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Everything about gscpe that must be seen on a real graphics driver, as one page of Markdown.
#
# Usage: tools/bench_gpu.sh [MAP_OR_PLY]      (PYTHON=... for another interpreter)
#
# Without a map, a made-up splat. With one of RedKitchen, and GSCPE_DATA, photos and tracking, too.
# Under 4 minutes on a GPU; on a software driver, the tables take fewer turns. Exit status: how
# many sections failed.
set -uo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
python=${PYTHON:-$root/.venv/bin/python}
export PYTHONPATH=$root${PYTHONPATH:+:$PYTHONPATH} PYTHONUNBUFFERED=1
splat=${1:+$(realpath "$1")}
cd "$root" || exit 1
failed=0

# section TITLE SECONDS COMMAND...: runs it, prints what it printed, PASS or FAIL, and its time.
section() {
    local title=$1 limit=$2 begin=$SECONDS status
    shift 2
    printf '\n## %s\n\n' "$title"
    timeout -k 5 "$limit" "$@" 2>&1
    status=$?
    if [ $status -eq 0 ]; then
        printf '\n**PASS** (%d s)\n' $((SECONDS - begin))
    else
        failed=$((failed + 1))
        printf '\n**FAIL** (status %d%s, %d s)\n' $status \
            "$([ $status -eq 124 ] && echo ', out of time')" $((SECONDS - begin))
    fi
}

# tests NAME...: the test files of these names, whichever folder they are in, OpenGL's cases alone.
tests() {
    local files=() name
    for name in "$@"; do files+=($(find tests -name "test_$name.py")); done
    [ ${#files[@]} -eq $# ] || { echo "test files are missing: $*"; return 1; }
    "$python" -m pytest -q -p no:cacheprovider --tb=short -k 'not cpu' "${files[@]}" | tail -n 40
}
export -f tests
export python

echo "# gscpe on this machine's graphics driver"
echo
echo "$(uname -sm), $(nproc) cores, $("$python" -V)"
if command -v nvidia-smi >/dev/null; then
    nvidia-smi --query-gpu=name,driver_version --format=csv,noheader
fi
section "Doctor" 60 "$python" -m gscpe doctor
section "Pictures against the NumPy compositor" 60 bash -o pipefail -c 'tests renderer absurd_splats'
section "Order and pictures of the compute shaders" 60 bash -o pipefail -c 'tests gpu_sort gpu_tiles'
section "Lifetime, threads, processes" 90 bash -o pipefail -c 'tests renderer_lifetime renderer_processes renderer_threads'
section "A localizer in many threads, views that tell little" 120 bash -o pipefail -c 'tests localizer_threads degenerate_views'
section "OpenGL against the CPU rasterizer" 60 "$python" tools/bench_gpu.py agree ${splat:+"$splat"}
section "A frame at 640x480" 60 "$python" tools/bench_gpu.py frame ${splat:+"$splat"}
if [ -n "$splat" ]; then
    section "Render table" 90 "$python" tools/bench_render.py "$splat" --repeats 3
fi
if [ -n "$splat" ] && [ -d "${GSCPE_DATA:-}/redkitchen" ]; then
    section "Photos" 120 "$python" tools/bench_easy.py "$splat" --queries 40
    section "Tracking" 60 "$python" tools/bench_tracking.py "$splat"
fi
printf '\n%s\n' "$([ $failed -eq 0 ] && echo 'All sections passed.' || echo "$failed sections FAILED.") $SECONDS s in all."
exit $failed
